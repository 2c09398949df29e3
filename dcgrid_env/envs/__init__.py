"""Environments: Gymnasium, Gymnasium vector, PettingZoo and tensors, on one engine."""
