"""Peak shaving: a storage keeps the voltage of its bus above a threshold and recharges above it.

    P_{t+1} = clip(P_t + g (V_t - V_hold) / R_ii, -p_rated, most)       P: draw of the storage, R_ii: p.u. for each MW
    most    = min(p_rated, (E_0 - E_t) / (eta_c h))                     E_0: energy that is to be stored at the end

At g = 1 the storage alone would bring its voltage to the threshold in one step. Peaks of draws upstream pull that
voltage down, those of the site at the same bus and of neighbours alike. So the rule needs no other measurement. It
charges up to its initial energy. Clocks and reactive power follow the paper's droop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines.controller import Local
from dcgrid_env.baselines.laws.droop import Droop
from dcgrid_env.baselines.parameter_checks import require_finite, require_non_negative


@dataclass
class PeakShaving(Droop):
    """Storages that shave peaks, in addition to the droop.

    Parameters
    ----------
    v_hold_pu
        Voltage below which a storage discharges, and above which it charges, p.u.
    gain
        Share of the way to the threshold that a storage goes in a step (g above).
    """

    v_hold_pu: float = 0.95
    gain: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        require_finite("peak-shaving", v_hold_pu=self.v_hold_pu)
        require_non_negative("peak-shaving", gain=self.gain)

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes; ValueError for a scenario without storages."""
        super().reset(env_info)
        if not has_storages(env_info):
            raise ValueError(
                f"peak-shaving: scenario {env_info.name!r} has no storage; give it devices=(.., Storages(..)), or use "
                "the law 'droop'"
            )
        self._figures = env_info.group("storage").parameters

    def draw(self, local: Local) -> np.ndarray:
        """See :class:`LocalController`."""
        figures, slots = self._figures, self._storages
        apart = local.v_pu[..., slots] - self.v_hold_pu
        wanted = local.p_kw[..., slots] + 1000.0 * self.gain * apart / np.maximum(local.r_pu_per_mw[..., slots], 1e-6)
        hours = self.scenario.dt_s / 3600.0
        lacking = np.maximum(figures.returned_kwh - local.stored_kwh, 0.0)
        most = np.minimum(figures.p_rated_kw, lacking / (figures.charge_efficiency * hours))
        return np.clip(wanted, -figures.p_rated_kw, most)


def has_storages(scenario: Scenario) -> bool:
    """Whether a scenario has storages that are agents."""
    return any(device.kind == "storage" and device.count for device in scenario.devices)
