"""Gains tuned on the validation split, and hindsight's costs of the test episodes."""
