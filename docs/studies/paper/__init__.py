"""Pages on the paper's study: its figures, the unbalanced feeder, and settings that the paper does not state."""
