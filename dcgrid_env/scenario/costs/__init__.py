"""The terms of the cost that the grid brings. Those of devices are in `devices`."""
