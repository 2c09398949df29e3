"""Run ``python -m dcgrid_env.cli``, which is the same as ``dcgrid``."""

from dcgrid_env.cli.main import main

main()
