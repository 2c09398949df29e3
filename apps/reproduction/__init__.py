"""The study of Y. Chen and B. Zhang, arXiv 2507.06416, with their reported figures next to ours."""
