"""Trained policies that ship: NAME.safetensors with NAME.json, its card."""
