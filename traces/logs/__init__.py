"""Reading text logs of any size: power over time, nvidia-smi, and requests."""
