"""The study of one connection request: capacity, base case, voltages, ride-through and fluctuation in one report."""
