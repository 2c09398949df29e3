"""Three-phase grids from GridLAB-D's .glm files, through the equivalent OpenDSS circuit."""

from dcgrid_env.apps.importers.gridlabd.glm_reading import read_gridlabd

__all__ = ["read_gridlabd"]
