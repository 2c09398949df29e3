"""What comes from outside the control: episodes, traces, noise and events."""
