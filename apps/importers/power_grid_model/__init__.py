"""power-grid-model's JSON files, read and written."""

from dcgrid_env.apps.importers.power_grid_model.pgm_reading import read_power_grid_model
from dcgrid_env.apps.importers.power_grid_model.pgm_writing import power_grid_model_text, write_power_grid_model

__all__ = ["power_grid_model_text", "read_power_grid_model", "write_power_grid_model"]
