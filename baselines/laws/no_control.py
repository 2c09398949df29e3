"""No control: every data centre at its top clock, no reactive power, no tap moved. Work is served as it arrives."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from dcgrid_env.baselines.controller import Local, LocalController


class NoControl(LocalController):
    """Run at the top clock without reactive power; regulators that are agents keep their position."""

    moves_taps: ClassVar[bool] = False

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`LocalController`."""
        return np.full_like(local.p_ref_next_kw, self.scenario.datacenters.f_max_mhz), np.zeros_like(local.v_pu)
