"""Ride-through and return: how long a device stays connected under a voltage, and how it comes back."""
