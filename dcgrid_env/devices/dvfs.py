"""How a GPU clock turns queued work into speed and power (dynamic voltage and frequency scaling).

A law may tell apart two kinds of work, its phases: compute-bound (prefill, training) and memory-bound (decode). It says
so with an attribute ``phases = 2``; without one it has a single phase.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np

from dcgrid_env.arrays import Array, namespace
from dcgrid_env.devices.params import DataCenterParams


class Dvfs(Protocol):
    """A clock law: what a site does with the work at hand at a given clock."""

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
            the top clock, kW: (..., n_dc), or with two phases (..., n_dc, 2), compute-bound first.

        Returns
        -------
        work_rate_kw, power_kw
            Work served, of the shape of ``work_kw`` and at most that, and dynamic power above idle, (..., n_dc), kW.
        """
        ...


def phases_of(dvfs: Any) -> int:
    """Number of kinds of work that a clock law tells apart."""
    return getattr(dvfs, "phases", 1)


def speed_share(dvfs: Dvfs, params: DataCenterParams, f_mhz: np.ndarray) -> np.ndarray:
    """Speed of each phase at a clock as a share of that at the top clock, (..., n_dc, n_phase), for ``f_mhz``
    (..., n_dc): how much of more work than can be done is done."""
    found = []
    for phase in range(phases_of(dvfs)):
        plenty = np.zeros((*f_mhz.shape, phases_of(dvfs)))
        plenty[..., phase] = 1e3 * params.p_dynamic_kw
        work = plenty if phases_of(dvfs) > 1 else plenty[..., 0]
        done, top = (dvfs.serve(params, f, work)[0] for f in (f_mhz, params.f_max_mhz + 0.0 * f_mhz))
        found.append(done[..., phase] / top[..., phase] if phases_of(dvfs) > 1 else done / top)
    return np.stack(found, axis=-1)


@dataclass(frozen=True)
class LinearDvfs:
    """Speed and dynamic power both proportional to the clock (arXiv 2507.06416, eq. 4)."""

    phases: ClassVar[int] = 1

    def serve(self, params: DataCenterParams, f_mhz: Array, work_kw: Array) -> tuple[Array, Array]:
        """See :class:`Dvfs`: what is served is what is drawn."""
        ceiling = params.p_dynamic_kw * (f_mhz / params.f_max_mhz)
        served = namespace(f_mhz).minimum(ceiling, work_kw)
        return served, served
