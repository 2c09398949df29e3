"""The terms of the cost that the grid brings; what devices are charged for stands in `devices`."""
