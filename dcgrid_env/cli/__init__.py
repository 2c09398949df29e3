"""Commands of the `dcgrid` command line: one configuration dataclass a file, with `run()`; `main` registers them."""
