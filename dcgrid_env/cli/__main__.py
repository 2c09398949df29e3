"""Runs ``python -m dcgrid_env.cli``, which is ``dcgrid``."""

from dcgrid_env.cli.main import main

main()
