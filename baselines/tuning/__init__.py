"""Parameters of laws: searched on the validation split, and found again by scenario."""
