"""The engine: draws episodes, steps devices and grid, observes, charges and measures; every environment runs on it."""
