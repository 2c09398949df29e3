"""Generated PV output around noon under passing clouds, as a share of the inverter's rating.

    share(t) = clear (1 - shade(t))

`clear` is drawn for each trace. Sun and cloud alternate for exponential times. Each cloud has its own depth and comes
and goes linearly over some seconds, the time in which its edge crosses the modules. Measurements show that output falls
by half and more within tens of seconds, and faster the smaller the plant [1]. The numbers below are choices, made so
that two minutes contain one or two clouds.

[1] A. Mills et al., "Understanding variability and uncertainty of photovoltaics for integration with the electric
power system", LBNL-2855E, 2009.
"""

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np

from dcgrid_env.traces.checks import FloatArray, steps_in
from dcgrid_env.traces.library import row_seed
from dcgrid_env.traces.provenance import generated
from dcgrid_env.traces.time_grid import GRID_S, check_range, grid_steps, rounded, stream
from dcgrid_env.traces.trace import PowerTrace

SUN = "pv"
"""Name of this generator, as a scenario's ``inverters.injection``."""

_RANGES = {
    "clear_share": (0.0, 1.0),
    "sun_mean_s": (1.0, 1e6),
    "cloud_mean_s": (1.0, 1e6),
    "shade": (0.0, 1.0),
    "edge_s": (0.1, 600.0),
}


@dataclass(frozen=True)
class PvParams:
    """A sky; pairs are ranges drawn from evenly. A field out of its range raises TraceError."""

    clear_share: tuple[float, float] = (0.75, 1.0)
    """Output without clouds as a share of the rating."""
    sun_mean_s: float = 50.0
    cloud_mean_s: float = 25.0
    shade: tuple[float, float] = (0.4, 0.8)
    """What a cloud takes."""
    edge_s: tuple[float, float] = (4.0, 20.0)
    """Time in which a cloud comes, and goes, s."""

    def __post_init__(self) -> None:
        for field in fields(self):
            check_range(self, field, _RANGES[field.name])


def generate_pv(duration_s: float, seed: int, params: PvParams | None = None) -> PowerTrace:
    """Generate PV output.

    Parameters
    ----------
    duration_s : length, s; rounded up to the grid of 0.1 s.
    seed : integer of at least 0; the same seed is the same trace.
    params : the sky.

    Returns
    -------
    PowerTrace with power in [0, 1], share of the rating, on a grid of 0.1 s

    Raises
    ------
    TraceError
        If the duration or the seed is out of range.
    """
    params = params or PvParams()
    n_steps = grid_steps(duration_s)
    rng = stream(SUN, seed)
    clear = rng.uniform(*params.clear_share)
    # The first turn of sun began before the trace does.
    time_s, end_s = -float(rng.exponential(params.sun_mean_s)), n_steps * GRID_S
    at_s, shade = [time_s], [0.0]
    while time_s < end_s:
        depth = rng.uniform(*params.shade)
        for level, mean_s in ((depth, params.cloud_mean_s), (0.0, params.sun_mean_s)):
            at_s += [time_s := time_s + rng.uniform(*params.edge_s), time_s := time_s + rng.exponential(mean_s)]
            shade += [level, level]
    grid_s = np.arange(n_steps + 1) * GRID_S
    share = rounded(clear * (1.0 - np.interp(grid_s, at_s, shade)))
    provenance = generated(SUN, seed, duration_s, params=params)
    return PowerTrace(grid_s, share, f"{SUN}-{seed}", provenance, rated_kw=1.0)


@lru_cache(maxsize=32)
def pv_rows(split: str, dt_s: float, duration_s: float, count: int) -> FloatArray:
    """Rows of generated PV, (count, n_steps), read-only; the splits share no seed, see `library`.

    Raises
    ------
    TraceError
        For an unknown split.
    """
    n_steps = steps_in(duration_s, dt_s)
    rows = [generate_pv(duration_s, row_seed(split, i)).resample(dt_s)[:n_steps] for i in range(count)]
    shares = np.array(rows)
    shares.setflags(write=False)
    return shares
