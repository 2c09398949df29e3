"""Clock laws: speed and power of queued work by GPU clock (dynamic voltage and frequency scaling).

A law may distinguish two classes of work: compute-bound (prefill, training) and memory-bound (decode). Its
attribute ``work_classes`` is then 2; without the attribute it has a single work class.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np

from dcgrid_env.core.arrays import Array, namespace
from dcgrid_env.devices.ratings import DataCenterParams


class Dvfs(Protocol):
    """Clock law: work served and power drawn by a site at a given clock."""

    def serve(self, params: DataCenterParams, f_mhz: Array, work_kw: Array) -> tuple[Array, Array]:
        """Work served and dynamic power drawn over an interval.

        Parameters
        ----------
        params
            Ratings of the sites, arrays that broadcast against the others.
        f_mhz
            Clock, MHz, shape (..., n_dc).
        work_kw
            Work at hand (arriving and queued), as the dynamic power that would serve all of it within the interval at
            the top clock, kW: (..., n_dc), or with two work classes (..., n_dc, 2), compute-bound first.

        Returns
        -------
        work_rate_kw, power_kw
            Work served, of the shape of ``work_kw`` and at most that, and dynamic power above idle, (..., n_dc), kW.
        """
        ...


def work_classes_of(dvfs: Any) -> int:
    """Return the number of work classes that a clock law distinguishes."""
    return getattr(dvfs, "work_classes", 1)


def speed_share(dvfs: Dvfs, params: DataCenterParams, f_mhz: np.ndarray) -> np.ndarray:
    """Return the speed of each work class at a clock as a share of that at the top clock, (..., n_dc, n_class).

    ``f_mhz`` has the shape (..., n_dc). The speed is measured with more work than the site can serve.
    """
    shares = []
    for work_class in range(work_classes_of(dvfs)):
        plenty = np.zeros((*f_mhz.shape, work_classes_of(dvfs)))
        plenty[..., work_class] = 1e3 * params.p_dynamic_kw
        work = plenty if work_classes_of(dvfs) > 1 else plenty[..., 0]
        done, top = (dvfs.serve(params, f, work)[0] for f in (f_mhz, params.f_max_mhz + 0.0 * f_mhz))
        shares.append(done[..., work_class] / top[..., work_class] if work_classes_of(dvfs) > 1 else done / top)
    return np.stack(shares, axis=-1)


@dataclass(frozen=True)
class LinearDvfs:
    """Speed and dynamic power both proportional to the clock (arXiv 2507.06416, eq. (4))."""

    work_classes: ClassVar[int] = 1

    def serve(self, params: DataCenterParams, f_mhz: Array, work_kw: Array) -> tuple[Array, Array]:
        """Return work served and power drawn, which are equal; see :class:`Dvfs`."""
        ceiling = params.p_dynamic_kw * (f_mhz / params.f_max_mhz)
        served = namespace(f_mhz).minimum(ceiling, work_kw)
        return served, served
