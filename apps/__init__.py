"""Applications of the environment. No other package imports them; the command table contains their commands."""
