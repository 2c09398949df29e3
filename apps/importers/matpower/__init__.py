"""MATPOWER case files, read without executing them, and written."""

from dcgrid_env.apps.importers.matpower.case_reading import read_matpower
from dcgrid_env.apps.importers.matpower.case_writing import matpower_text, write_matpower

__all__ = ["matpower_text", "read_matpower", "write_matpower"]
