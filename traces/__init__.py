"""Power traces: recorded ones, loaded and averaged with their energy kept, and generated ones from a seed.

A scenario draws from `library(source, split, dt_s, duration_s)` or `from_recordings(traces, split, dt_s)`: rows of
power as a share of the site's rating, of which an episode takes a window.
"""

from dcgrid_env.traces.grid import AWAKE_SHARE, GRID_S, IDLE_SHARE
from dcgrid_env.traces.inference import InferenceParams, generate_inference
from dcgrid_env.traces.library import (
    SPLITS,
    TRACE_SOURCES,
    TraceRows,
    TraceSource,
    from_recordings,
    library,
    require_window,
    row_seed,
)
from dcgrid_env.traces.mixed import generate_mixed
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.step import generate_step
from dcgrid_env.traces.trace import PowerTrace, RequestTimes, TraceError
from dcgrid_env.traces.training import TrainingParams, generate_training

__all__ = [
    "AWAKE_SHARE",
    "GRID_S",
    "IDLE_SHARE",
    "SPLITS",
    "TRACE_SOURCES",
    "InferenceParams",
    "PowerTrace",
    "Provenance",
    "RequestTimes",
    "TraceError",
    "TraceRows",
    "TraceSource",
    "TrainingParams",
    "from_recordings",
    "generate_inference",
    "generate_mixed",
    "generate_step",
    "generate_training",
    "library",
    "require_window",
    "row_seed",
]
