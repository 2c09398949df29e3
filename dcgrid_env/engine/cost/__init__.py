"""What a step costs, what agents observe, and the metrics of an episode."""
