"""Power of data centres over time: recordings, loaded with their energy kept, and generators that repeat from a seed.

A scenario draws from `library(source, split, dt_s, duration_s)` or `from_recordings(traces, split, dt_s)`: rows of
power as a share of the site's rating, of which an episode takes a window.
"""

from dcgrid_env.traces.by_name import is_recording, recorded_trace
from dcgrid_env.traces.checks import TraceError
from dcgrid_env.traces.day_course import load_share, sun_share
from dcgrid_env.traces.inference import InferenceParams, generate_inference
from dcgrid_env.traces.library import library, row_seed
from dcgrid_env.traces.logs.dmon_log import read_dmon_log
from dcgrid_env.traces.logs.gpu_log import read_gpu_log
from dcgrid_env.traces.logs.power_json import read_power_json
from dcgrid_env.traces.logs.request_log import read_request_log
from dcgrid_env.traces.logs.smi_dmon_log import read_smi_dmon_log
from dcgrid_env.traces.logs.stamped_csv import read_stamped_csv
from dcgrid_env.traces.logs.wattameter_log import read_wattameter_log
from dcgrid_env.traces.mixed import generate_mixed
from dcgrid_env.traces.on_demand import RowsOnDemand, rows_on_demand
from dcgrid_env.traces.profile_file import read_classes, read_profiles, write_profiles
from dcgrid_env.traces.profile_table import ProfileTable
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.pv import SUN, PvParams, generate_pv, pv_rows
from dcgrid_env.traces.recorded_rows import from_recordings
from dcgrid_env.traces.recorder import record
from dcgrid_env.traces.recordings import RECORDINGS, Recording, cache_folder, fetch, load_power, load_requests
from dcgrid_env.traces.rows import ALL_SPLITS, SPLITS, WHOLE, TraceRows, require_window
from dcgrid_env.traces.serving.arrivals import Arrivals
from dcgrid_env.traces.serving.hardware import GPUS, MODELS, Gpu, Model, Replica, replica
from dcgrid_env.traces.serving.pool import Served, serve
from dcgrid_env.traces.serving.requests import Requests
from dcgrid_env.traces.serving.services import SERVICES, Service, TokenLaw, requests
from dcgrid_env.traces.serving.site import Site, Tenant, generate_site, generate_sites
from dcgrid_env.traces.sources import TRACE_SOURCES, TraceSource
from dcgrid_env.traces.step import generate_step
from dcgrid_env.traces.time_grid import AWAKE_SHARE, GRID_S, IDLE_SHARE
from dcgrid_env.traces.trace import PowerTrace, RequestTimes
from dcgrid_env.traces.training.params import TrainingParams
from dcgrid_env.traces.training.smoothing import PowerSmoothing
from dcgrid_env.traces.training.training_site import generate_training

__all__ = [
    "ALL_SPLITS",
    "AWAKE_SHARE",
    "GPUS",
    "GRID_S",
    "IDLE_SHARE",
    "MODELS",
    "RECORDINGS",
    "SERVICES",
    "SPLITS",
    "SUN",
    "TRACE_SOURCES",
    "WHOLE",
    "Arrivals",
    "Gpu",
    "InferenceParams",
    "Model",
    "PowerSmoothing",
    "PowerTrace",
    "ProfileTable",
    "Provenance",
    "PvParams",
    "Recording",
    "Replica",
    "RequestTimes",
    "Requests",
    "RowsOnDemand",
    "Served",
    "Service",
    "Site",
    "Tenant",
    "TokenLaw",
    "TraceError",
    "TraceRows",
    "TraceSource",
    "TrainingParams",
    "cache_folder",
    "fetch",
    "from_recordings",
    "generate_inference",
    "generate_mixed",
    "generate_pv",
    "generate_site",
    "generate_sites",
    "generate_step",
    "generate_training",
    "is_recording",
    "library",
    "load_power",
    "load_requests",
    "load_share",
    "pv_rows",
    "read_classes",
    "read_dmon_log",
    "read_gpu_log",
    "read_power_json",
    "read_profiles",
    "read_request_log",
    "read_smi_dmon_log",
    "read_stamped_csv",
    "read_wattameter_log",
    "record",
    "recorded_trace",
    "replica",
    "requests",
    "require_window",
    "row_seed",
    "rows_on_demand",
    "serve",
    "sun_share",
    "write_profiles",
]
