"""A power cap instead of a clock: the firmware lowers the clock only while a GPU would draw more than the cap.

The setpoint f / f_max is the cap, as a share c of the dynamic power (idle draw excluded). Each class of work gets the
highest clock that meets it, by the curves of ``prefill_decode.py``:

    a x + (1 - a) x^3 = c              compute-bound: prefill, training
    delta (mu + (1 - mu) x^3) = c      memory-bound: decode; x = 1 where delta <= c, and at least f_min / f_max

A cap therefore costs compute-bound work less speed than the same share of the clock, and decode none before the cap
falls to delta. Published: a cap of 0.70 lengthened an inference of LLaMA 65B on an A100 by 7 % and saved 23 % of its
energy (arXiv 2310.03003). A cap of 0.60 saved 14 % of the energy of training (arXiv 2205.09646). Decode on an H200
draws 137 to 300 of 700 W at any cap (arXiv 2605.11999), on an H100 370 to 550 W (``traces/serving/hardware.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

from dcgrid_env.core.arrays import Array, positive_part
from dcgrid_env.devices.datacenter.prefill_decode import PrefillDecodeDvfs

_NEWTON_STEPS = 6
"""Enough for full precision of a cap from 0.1 to 1 (a test measures it)."""


@dataclass(frozen=True)
class PowerCapDvfs(PrefillDecodeDvfs):
    """Speed and power by work class under a power cap, see the module; ValueError for a share outside 0 to 1."""

    decode_draw_share: float = 0.5
    """Dynamic power of a GPU in decode at the top clock as a share of that in prefill, delta. A choice: 0.11 to 0.37
    follow from the H200's figures, 0.48 to 0.77 from the H100's."""

    def _clocks(self, setpoint: Array, lowest: Array) -> tuple[Array, Array]:
        a, mu = self.compute_linear_share, self.decode_memory_share
        x = setpoint ** (1.0 / 3.0)  # not below the root, so that Newton's method only falls
        for _ in range(_NEWTON_STEPS):
            cube = x * x * x
            x = x - (cube + a * (x - cube) - setpoint) / (3.0 * x * x + a * (1.0 - 3.0 * x * x))
        # As written, a cap of 1 gives a clock of 1 to the bit.
        missing = positive_part(1.0 - setpoint / max(self.decode_draw_share, 1e-9))
        cube = 1.0 - missing / max(1.0 - mu, 1e-9)
        return x, (cube + positive_part(lowest**3 - cube)) ** (1.0 / 3.0)
