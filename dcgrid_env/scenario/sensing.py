"""Information of agents and controllers on the grid: scope, noise, delay, preview, and errors of their model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from dcgrid_env.core.checked import as_tuples, choice, count, finite, number, refuse, settle

ObservationScope = Literal["local", "neighbours", "feeder"]
LARGEST_TIE_OHM = 1e4
"""Largest resistance and reactance of a tie, ohm; a longer line than any distribution feeder has."""


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
    model_open: tuple[tuple[str, str], ...] = ()
    """Closed branches that the model of agents and controllers takes for open, each by its two buses; only for a
    balanced feeder. The shares of R and X apply afterwards."""
    model_closed: tuple[tuple[str, str, float, float], ...] = ()
    """Open ties that the model of agents and controllers takes for closed, each by its two buses, resistance and
    reactance, ohm; only for a balanced feeder."""

    def __post_init__(self) -> None:
        settle(self, model_open=_with_bus_names, model_closed=_with_bus_names)
        if not _are_branches(self.model_open, 0):
            raise refuse(self, "model_open", "give a list of branches, each as two buses: [['6', '7']]")
        if not _are_branches(self.model_closed, 2):
            remedy = (
                f"give a list of ties, each as two buses, r and x of 0 to {LARGEST_TIE_OHM:g} ohm: "
                "[['12', '22', 2.0, 2.0]]"
            )
            raise refuse(self, "model_closed", remedy)


def _with_bus_names(value: object) -> object:
    """Return rows with whole numbers in the first two places as text; other values unchanged."""
    rows = as_tuples(value)
    if not isinstance(rows, tuple) or not all(isinstance(row, tuple) for row in rows):
        return value
    return tuple(
        (*(str(bus) if type(bus) is int else bus for bus in row[:2]), *(float(r) if finite(r) else r for r in row[2:]))
        for row in rows
    )


def _are_branches(rows: object, n_ohm: int) -> bool:
    """Return whether these are rows of two buses and some impedances."""
    return isinstance(rows, tuple) and all(
        isinstance(row, tuple)
        and len(row) == 2 + n_ohm
        and all(isinstance(bus, str) for bus in row[:2])
        and all(finite(ohm, 0.0, LARGEST_TIE_OHM) for ohm in row[2:])
        for row in rows
    )
