"""Scenarios: the settings fixed before an episode is drawn, their checks, plain form, fingerprint and presets."""
