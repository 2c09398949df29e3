"""Voltage regulators that change their taps: by the control of their bank, or at an agent's command."""
