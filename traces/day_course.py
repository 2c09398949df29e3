"""Daily profiles: a feeder's load as a share of its peak, and clear-sky PV output as a share of that at noon.

Load: hourly peak load in percent of the daily peak, summer weekday (weeks 18 to 30) of the IEEE Reliability Test System
(IEEE Committee Report, "IEEE reliability test system", IEEE Trans. Power Apparatus and Systems PAS-98, 1979, table 4).
Sun: clear-sky irradiance on a horizontal plane after B. Haurwitz ("Insolation in relation to cloudiness and cloud
density", Journal of Meteorology 2, 1945), 1098 cos z exp(-0.057 / cos z) W/m2, z the sun's zenith angle, on the longest
day of the year at 40 degrees north, over that at noon. Hours are solar time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dcgrid_env.traces.checks import FloatArray
from dcgrid_env.traces.time_grid import rounded

LOAD_PERCENT = (
    64, 60, 58, 56, 56, 58, 64, 76, 87, 95, 99, 100, 99, 100, 100, 97, 96, 96, 93, 92, 92, 93, 87, 72,
)  # fmt: skip
"""Share of each hour from midnight on."""
LATITUDE_DEG = 40.0
DECLINATION_DEG = 23.45


def load_share(hour: ArrayLike) -> FloatArray:
    """Return the load as a share of the day's peak, in [0.56, 1], at a time of day, h, of any shape and beyond 24 too.

    The profile is linear between the middles of the hours.
    """
    middles = np.arange(24) + 0.5
    return rounded(np.interp(np.asarray(hour, np.float64), middles, np.array(LOAD_PERCENT) / 100.0, period=24.0))


def sun_share(hour: ArrayLike) -> FloatArray:
    """Return the clear-sky PV output as a share of that at noon, in [0, 1], at a time of day, h, of any shape."""
    return rounded(_clear_sky(np.asarray(hour, np.float64)) / _clear_sky(np.float64(12.0)))


def _clear_sky(hour: FloatArray | np.float64) -> FloatArray:
    latitude, declination = np.deg2rad(LATITUDE_DEG), np.deg2rad(DECLINATION_DEG)
    turned = np.deg2rad(15.0 * (hour - 12.0))
    cos_z = np.sin(latitude) * np.sin(declination) + np.cos(latitude) * np.cos(declination) * np.cos(turned)
    up = np.maximum(cos_z, 1e-3)
    return np.where(cos_z > 1e-3, up * np.exp(-0.057 / up), 0.0)
