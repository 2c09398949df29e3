"""Information of agents and controllers on the grid: scope, noise, delay, preview, and errors of their model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from dcgrid_env.core.checked import check_fields, choice, count, number, settle

ObservationScope = Literal["local", "neighbours", "feeder"]


@dataclass(frozen=True, kw_only=True)
class Sensing:
    """Measurements, and the grid model of agents and controllers."""

    noise_pu: float = number(0.0, 1.0, default=0.0)
    """Standard deviation of the voltage measurement, p.u."""
    delay_steps: int = count(0, 10_000, default=0)
    """Age of the measured voltage, steps."""
    observe: ObservationScope = choice("local", "neighbours", "feeder", default="local")
    """Scope of an agent's observation: its own figures, those of its nearest agents too, or every bus of the feeder."""
    preview: bool = choice(True, False, default=True)
    """Whether a data centre observes its p_ref over the coming interval."""
    loading: bool = choice(True, False, default=False)
    """Whether an agent observes the loading of the branch that feeds its bus; only for a feeder with ratings."""
    regulator: bool = choice(True, False, default=False)
    """Whether an agent observes the regulator upstream of its bus; only for a three-phase feeder with regulators."""
    regulator_delay_s: float = number(0.0, 86_400.0, default=2.0)
    """Age of what it observes of the regulator, s, rounded up to steps."""
    r_model_share: float = number(0.0, 10.0, default=1.0)
    """Resistance of every branch in the model of agents and controllers, as a share of the true one."""
    x_model_share: float = number(0.0, 10.0, default=1.0)
    """Reactance of every branch in the model of agents and controllers, as a share of the true one."""

    def __post_init__(self) -> None:
        settle(self)
        check_fields(self)
