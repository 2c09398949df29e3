"""Studies of control laws."""
