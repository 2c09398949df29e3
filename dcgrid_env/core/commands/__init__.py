"""Tools that all commands share: their base class, options, checks of settings, and output on the terminal."""
