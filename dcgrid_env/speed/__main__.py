"""Runs ``python -m dcgrid_env.speed``."""

from dcgrid_env.speed.rates import main

main()
