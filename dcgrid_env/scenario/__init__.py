"""Scenarios: what is fixed before an episode is drawn, its checks, plain form and fingerprint, and the presets."""
