"""Commands of the `dcgrid` command line: a configuration dataclass and main(cfg) each."""
