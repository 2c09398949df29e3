"""The project's own folders of CSV files; files of other programs are read by ``dcgrid_env.apps.importers``."""
