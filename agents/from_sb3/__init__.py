"""Models of Stable-Baselines3 as policies: read without unpickling, driven by SB3 itself where the user trusts them."""
