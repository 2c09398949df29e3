"""pandapower's nets: read, from a file without running what it names, and written."""

from dcgrid_env.apps.importers.pandapower.net_reading import read_pandapower
from dcgrid_env.apps.importers.pandapower.net_writing import pandapower_net, write_pandapower

__all__ = ["pandapower_net", "read_pandapower", "write_pandapower"]
