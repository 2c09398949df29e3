"""Three-phase grids from OpenDSS's files, one component a file; the parsing is OpenDSS's own."""

from dcgrid_env.apps.importers.import_report import Finding
from dcgrid_env.apps.importers.opendss.circuit_process import read_opendss
from dcgrid_env.apps.importers.opendss.dss_losses import LossEffect
from dcgrid_env.apps.importers.opendss.dss_shapes import ImportedProfiles, write_imported_profiles
from dcgrid_env.apps.importers.opendss.reading import Imported

__all__ = ["Finding", "Imported", "ImportedProfiles", "LossEffect", "read_opendss", "write_imported_profiles"]
