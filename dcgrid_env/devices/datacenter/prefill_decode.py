"""A law of two work classes: prefill and training follow the clock, decode hardly does; power falls faster than speed.

Let x = f / f_max. These are the speed of work and the dynamic power of a busy site, as shares of those at the top
clock:

    speed_c = x                               power_c = a x + (1 - a) x^3         compute-bound: prefill, training
    speed_m = 1 / (1 + kappa (1 / x - 1))     power_m = mu + (1 - mu) x^3         memory-bound: decode

Work w is measured in the dynamic power that it takes at the top clock, and P is the dynamic power of the site. The
classes share its time in proportion to the available work. All of it would take the share tau of the interval:

    tau   = w_c / (P speed_c) + w_m / (P speed_m)
    d     = w / max(tau, 1)                                             served, of both work classes
    power = d_c power_c / speed_c + d_m power_m / speed_m

At the top clock the power therefore equals the work served, whatever its composition. Sources of the figures:

- speed_c: 5 to 7 % of throughput lost for each 100 MHz of an A100's 1410, that is in proportion. No parameter.
- decode_clock_share, kappa: decode takes 1 to 6 % longer at lower clocks (arXiv 2501.08219, from 2842 down to 180 MHz).
  Here it is 2 % at half the top clock, 6 % at a quarter and 11 % at 210 of 1410 MHz.
- decode_memory_share, mu: fitted, so that with an idle draw of 0.2 and a dynamic one of 0.45 of the rating a token
  takes at best 42 % less energy (that paper's saving, on average); here that is at 0.3 of the top clock.
- compute_linear_share, a: a choice, for f V^2 with a voltage that stops falling at low clocks.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import ClassVar

from dcgrid_env.core.arrays import Array, positive_part
from dcgrid_env.devices.ratings import DataCenterParams


@dataclass(frozen=True)
class PrefillDecodeDvfs:
    """Speed and power by work class, see the module; ValueError for a parameter outside 0 .. 1."""

    decode_clock_share: float = 0.02
    """Part of decode's time at the top clock that grows as the clock falls, kappa."""
    decode_memory_share: float = 0.34
    """Part of decode's dynamic power at the top clock that does not follow the clock, mu."""
    compute_linear_share: float = 0.4
    """Part of the compute-bound dynamic power that is linear in the clock, the rest its cube, a."""

    work_classes: ClassVar[int] = 2

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (isinstance(value, int | float) and 0.0 <= value <= 1.0):
                raise ValueError(f"{type(self).__name__}: {field.name} is {value!r}; give a share from 0 to 1")

    def serve(self, params: DataCenterParams, f_mhz: Array, work_kw: Array) -> tuple[Array, Array]:
        """See :class:`Dvfs`: ``work_kw`` and what is served of it are (..., n_dc, 2), compute-bound first."""
        compute, memory = work_kw[..., 0], work_kw[..., 1]
        x_c, x_m = self._clocks(f_mhz / params.f_max_mhz, params.f_min_mhz / params.f_max_mhz)
        slow, square, cube = 1.0 / x_c, x_c * x_c, x_m * x_m * x_m
        # Time and energy of a unit of work, of which both work classes have 1 at the top clock, to the bit.
        time_m = 1.0 + self.decode_clock_share * (1.0 / x_m - 1.0)
        energy_c = square + self.compute_linear_share * (1.0 - square)
        energy_m = (cube + self.decode_memory_share * (1.0 - cube)) * time_m
        tau = (compute * slow + memory * time_m) / params.p_dynamic_kw
        share = 1.0 / (1.0 + positive_part(tau - 1.0))
        return work_kw * share[..., None], (compute * energy_c + memory * energy_m) * share

    def _clocks(self, setpoint: Array, lowest: Array) -> tuple[Array, Array]:
        """Clock of compute-bound and of memory-bound work, as shares of the top clock."""
        return setpoint, setpoint
