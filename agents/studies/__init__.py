"""Studies of learning: trainings that belong together, scored on the test split, with their tables and figures."""
