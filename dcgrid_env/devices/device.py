"""What a group of devices is: frozen parameters, a state, and a pure step; and what it says of itself.

Parameters are arrays over the group's slots, a state is a NamedTuple of arrays (row, slot), and functions run on NumPy
arrays and tensors alike, writing nothing in place. Every device meets the grid through a converter of its own: it says
what active power it draws, and the engine cuts the reactive setpoint at what the converter has left (``converter``).
The engine loops over a scenario's devices; nothing above this folder knows a kind, but a controller made for it.
"""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np

from dcgrid_env.core.arrays import Array

Q = "q"
"""Name of the channel that is the converter's reactive setpoint, kvar, injection positive."""


class Channel(NamedTuple):
    """One of the setpoints of a device; an agent's action is its device's channels in order, each in [-1, 1]."""

    name: str
    unit: str
    lowest: np.ndarray
    """What -1 stands for, (slot,)."""
    highest: np.ndarray
    """What 1 stands for, (slot,)."""
    rest: np.ndarray
    """Setpoint at t = 0, (slot,)."""


class Field(NamedTuple):
    """A figure that an agent observes beside what all agents see of the grid."""

    name: str
    unit: str
    lowest: float
    highest: float
    share_of: np.ndarray
    """What the raw figure is divided by, (slot,)."""
    of_preview: bool = False
    """Whether it is 0 unless the scenario grants the preview."""
    of_band: bool = False
    """Whether it is a deviation of a voltage: figure and range are then divided by the scenario's band too, as those of
    ``v_deviation`` are."""
    of_all_sites: bool = False
    """Whether it takes a sum over all sites, which no site measures."""


class CostTerm(NamedTuple):
    """A term of the cost that a device brings."""

    name: str
    amount: str
    """Field of the device's state that is charged, or a name that its ``amount`` understands."""
    own_scale: np.ndarray
    """What an agent's amount is divided by in its own cost, (slot,)."""
    team_scale: float
    """What the sum of the amounts is divided by in the team's."""
    largest: float
    """Upper bound of the share in a step: charged once the power flow has no solution."""
    at_end: bool = False
    """Whether it is charged after the last step alone."""
    weight: float | None = None
    """Weight of a term that ``CostWeights`` does not have."""
    is_constraint: bool = False
    """Whether the term is part of ``info["cost"]``, which constrained learners keep low."""


class GridChange(NamedTuple):
    """What a device changes of the grid itself over an interval; None for what it leaves alone."""

    shunt_kvar: Array | None = None
    """Reactive injection of a switched shunt at the device's nodes, kvar, (row, slot)."""
    tap_ratio: Array | None = None
    """Ratio of the regulator that each slot moves, 1 in the neutral position, (row, slot)."""


class Work(NamedTuple):
    """What a device is asked to do over one interval, where ``Device.input`` is "workload"."""

    p_ref_kw: Array
    """Draw at the top clock with nothing queued, kW, (row, slot)."""
    compute_share: Array | None
    """Compute-bound share of the work that arrives, (row, slot); None under a clock law of one work class."""
    available: Array | None = None
    """1 where a site is connected to the grid and 0 where a fault has taken it, (row, slot); None where all are."""


@runtime_checkable
class Device(Protocol):
    """A group of devices of one kind."""

    kind: ClassVar[str]
    """Its name in scenario files, faults and messages."""
    prefix: ClassVar[str]
    """What its agents' ids begin with."""
    input: ClassVar[str | None]
    """What drives it from outside: "workload" (:class:`Work`), "injection" (kW, (row, slot)), "connection" (1 where
    it is connected to the grid and 0 where not, (row, slot), or None where all are), or None."""
    levels: ClassVar[tuple[str, ...]]
    """Fields of the state that are amounts at an instant, and so have a value at t = 0; the others are of a step."""

    changes_grid: ClassVar[bool]
    """Whether ``grid_change`` is to be asked."""

    @property
    def count(self) -> int:
        """Number of slots."""
        ...

    @property
    def buses(self) -> tuple[int | str, ...] | None:
        """Buses of the slots, or None: drawn in each episode."""
        ...

    @property
    def parameters(self) -> Any:
        """NamedTuple of arrays (slot,)."""
        ...

    @property
    def p_scale_kw(self) -> np.ndarray:
        """Rating that a draw is a share of, kW, (slot,)."""
        ...

    @property
    def converter_kva(self) -> np.ndarray:
        """Apparent-power rating of the converter, kVA, (slot,)."""
        ...

    @property
    def q_limit_kvar(self) -> np.ndarray:
        """Reactive limit at zero active power, kvar, (slot,); 0 for a device without a reactive channel."""
        ...

    @property
    def largest_draw_share(self) -> float:
        """Highest draw as a share of ``p_scale_kw``."""
        ...

    @property
    def channels(self) -> tuple[Channel, ...]:
        """What controls it."""
        ...

    def fields(self, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """What it observes, in the order of ``observe``."""
        ...

    def cost_terms(self, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        """What it is charged for."""
        ...

    def check_episode(self, horizon: int) -> None:
        """Raise FieldError for what cannot serve an episode of so many steps."""
        ...

    def initial(self, parameters: Any, zero: Array) -> Any:
        """State before t = 0; ``zero`` is 0, (row, slot)."""
        ...

    def step(
        self, parameters: Any, state: Any, setpoints: tuple[Array, ...], given: Any, dt_s: float
    ) -> tuple[Any, Array]:
        """Advance by one interval.

        Parameters
        ----------
        parameters, state
            Those of before, arrays of one kind.
        setpoints
            What each channel but the reactive one is set to, (row, slot) each, in the order and units of ``channels``.
        given
            What comes from outside, see ``input``.
        dt_s
            Length of the interval, s.

        Returns
        -------
        state, p_kw
            State at the end, and the draw from the grid, kW, (row, slot), an injection negative.
        """
        ...

    def grid_change(self, parameters: Any, state: Any) -> GridChange:
        """What the grid is like over the interval that ``state`` ends, beside what the device draws."""
        ...

    def observe(self, parameters: Any, state: Any, given_next: Any) -> tuple[Array, ...]:
        """Raw figures of the fields, (row, slot) each; ``given_next`` is what comes over the coming interval."""
        ...

    def amount(self, name: str, parameters: Any, state: Any) -> Array:
        """What a cost term charges, (row, slot)."""
        ...

    def totals(self, state: Any) -> dict[str, Array]:
        """Figures of all slots together in ``info``, (row,) each."""
        ...

    def metrics(self, history: Any, dt_s: float, requests: Any) -> dict[str, float]:
        """Figures of an episode.

        Parameters
        ----------
        history
            The state's fields over time, (T + 1, slot) each, from the reset on.
        dt_s
            Length of a step, s.
        requests
            For each slot, the requests behind its work and the time among them, s, at which the episode begins; None
            where no slot's work is made of requests.
        """
        ...


def may_leave(device: Any) -> bool:
    """Whether devices of a group may leave the grid by themselves: those that have a rule, ``ride_through``.

    Such a group's ``step`` is given a ``ride_through.connection.Supply`` around what it is given in any case, and has a
    method ``connected``: from its state to the share of its power that is on the grid, (row, slot), which its reactive
    power is cut by.
    """
    return getattr(device, "ride_through", None) is not None
