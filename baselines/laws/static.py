"""Constant reactive power: one number, one for each agent, or a rule by the agent's place.

    ConstantQ       q = share q_limit
    PlacementRule   q = clip(a + b R_ii + c X_ii, -1, 1) q_limit        q_limit: the reactive limit at zero active power

R_ii and X_ii are the drops of the own voltage for 1 MW and 1 Mvar drawn: zero at the substation, large at a feeder's
end. These are the fairest simple rivals of a learner that sees R_ii and X_ii, as they use the place alone. The data
centres run at their top clock. Reactive power is cut to what the converter can supply with its active power.

The defaults are one compromise over three presets, found on the validation split (never the test split) with

    dcgrid tune --laws constant-q,placement --scenarios toy6,ieee123,ieee33-weak --together

J is then on average 0.512 of no control's with one number and 0.457 with the rule. They can do harm on other presets:
injecting is wrong if PV raises the voltage (``mixed``). What was found for each preset alone ships as
``constant-q-tuned``, one share for each agent (one for all data centres where they are drawn), and ``placement-tuned``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines.controller import Local, LocalController
from dcgrid_env.baselines.parameter_checks import require_finite


@dataclass
class ConstantQ(LocalController):
    """A constant reactive setpoint.

    Parameters
    ----------
    q_share
        Share of the reactive limit, -1 to 1, injection positive: one number, or one for each agent, data centres first.
    """

    name: ClassVar[str] = "constant-q"

    q_share: float | tuple[float, ...] = 0.7122

    def __post_init__(self) -> None:
        if isinstance(self.q_share, list | np.ndarray):
            self.q_share = tuple(self.q_share)
        for value in self.q_share if isinstance(self.q_share, tuple) else (self.q_share,):
            if not -1.0 <= value <= 1.0:
                raise ValueError(f"{self.name}: q_share is {value!r}; give shares from -1 to 1")

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes; ValueError where there is not one share for each agent."""
        super().reset(env_info)
        n_agent = self.scenario.n_agents
        if isinstance(self.q_share, tuple) and len(self.q_share) != n_agent:
            raise ValueError(
                f"{self.name}: q_share has {len(self.q_share)} shares; {env_info.name} has {n_agent} agents with a bus"
            )

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`LocalController`."""
        share = np.asarray(self.q_share) + np.zeros_like(local.v_pu)
        return np.full_like(local.p_ref_next_kw, self.scenario.datacenters.f_max_mhz), share * self._q_scale


@dataclass
class PlacementRule(LocalController):
    """A constant reactive setpoint that depends on the agent's place.

    Parameters
    ----------
    at_substation
        Share of the reactive limit where R_ii = X_ii = 0.
    per_r_mw_per_pu, per_x_mvar_per_pu
        What is added to it for each p.u. per MW of R_ii and p.u. per Mvar of X_ii.
    """

    at_substation: float = 0.001432
    per_r_mw_per_pu: float = 39.53
    per_x_mvar_per_pu: float = -3.62

    def __post_init__(self) -> None:
        require_finite(
            "placement",
            at_substation=self.at_substation,
            per_r_mw_per_pu=self.per_r_mw_per_pu,
            per_x_mvar_per_pu=self.per_x_mvar_per_pu,
        )

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`LocalController`."""
        share = (
            self.at_substation + self.per_r_mw_per_pu * local.r_pu_per_mw + self.per_x_mvar_per_pu * local.x_pu_per_mvar
        )
        return np.full_like(local.p_ref_next_kw, self.scenario.datacenters.f_max_mhz), np.clip(
            share, -1.0, 1.0
        ) * self._q_scale
