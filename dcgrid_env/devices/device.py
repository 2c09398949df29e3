"""Interface of a group of devices: frozen parameters, a state, a pure step, and descriptions of its data.

Parameters are arrays over the group's slots, a state is a NamedTuple of arrays (row, slot), and functions run on NumPy
arrays and tensors alike, writing nothing in place. Every device has its own converter at the grid. It returns its
active power, and the engine limits the reactive setpoint to the remaining capacity of the converter (``converter``).
The engine loops over a scenario's devices. Code above this folder does not depend on a kind, except for controllers
made for one.
"""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.traces import RequestTimes

Q = "q"
"""Name of the channel that is the converter's reactive setpoint, kvar, injection positive."""
DeviceParams = Any
"""Parameters of a group of devices: a NamedTuple of arrays (slot,), each kind its own."""
DeviceState = Any
"""State of a group of devices: a NamedTuple of arrays (row, slot, ..), each kind its own; of an episode (T + 1, slot,
..)."""
DeviceInput = Any
"""Exogenous input of a group of devices, see ``Device.input``."""
Requests = list[tuple[RequestTimes, float]] | None
"""Requests of each slot and the time in their series, s, at which an episode begins; None without any."""


class Channel(NamedTuple):
    """One of the setpoints of a device; an agent's action is its device's channels in order, each in [-1, 1]."""

    name: str
    unit: str
    lowest: np.ndarray
    """Setpoint at action -1, (slot,)."""
    highest: np.ndarray
    """Setpoint at action 1, (slot,)."""
    rest: np.ndarray
    """Setpoint at t = 0, (slot,)."""


class Field(NamedTuple):
    """Figure that an agent observes in addition to the grid fields of all agents."""

    name: str
    unit: str
    lowest: float
    highest: float
    share_of: np.ndarray
    """Divisor of the raw figure, (slot,)."""
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
    """Field of the device's state that is charged, or a name that its ``amount`` accepts."""
    own_scale: np.ndarray
    """Divisor of an agent's amount in its own cost, (slot,)."""
    team_scale: float
    """Divisor of the sum of the amounts in the team's cost."""
    largest: float
    """Upper bound of the share in a step: charged once the power flow has no solution."""
    at_end: bool = False
    """Whether it is charged only after the last step."""
    weight: float | None = None
    """Weight of a term that ``CostWeights`` does not have."""
    is_constraint: bool = False
    """Whether the term is part of ``info["cost"]``, which constrained learners keep low."""


class GridChange(NamedTuple):
    """Changes of a device to the grid itself over an interval; None where it changes nothing."""

    shunt_kvar: Array | None = None
    """Reactive injection of a switched shunt at the device's nodes, kvar, (row, slot)."""
    tap_ratio: Array | None = None
    """Ratio of the regulator that each slot moves, 1 in the neutral position, (row, slot)."""


class Work(NamedTuple):
    """Work that a device receives over one interval if ``Device.input`` is "workload"."""

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
    """Name in scenario files, faults and messages."""
    prefix: ClassVar[str]
    """Prefix of its agents' ids."""
    input: ClassVar[str | None]
    """Exogenous input: "workload" (:class:`Work`), "injection" (kW, (row, slot)), "connection" or None.

    "connection" is 1 where it is connected to the grid and 0 where not, (row, slot), or None where all are."""
    levels: ClassVar[tuple[str, ...]]
    """Fields of the state at an instant, which have a value at t = 0; the others belong to a step."""

    changes_grid: ClassVar[bool]
    """Whether the engine calls ``grid_change``."""

    @property
    def count(self) -> int:
        """Number of slots."""
        ...

    @property
    def buses(self) -> tuple[int | str, ...] | None:
        """Buses of the slots, or None: drawn in each episode."""
        ...

    @property
    def parameters(self) -> DeviceParams:
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
        """Channels of its actions."""
        ...

    def fields(self, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """Observed fields, in the order of ``observe``."""
        ...

    def cost_terms(self, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        """Cost terms of the group."""
        ...

    def check_episode(self, horizon: int) -> None:
        """Raise FieldError for settings that do not allow an episode of that many steps."""
        ...

    def initial(self, parameters: DeviceParams, zero: Array) -> DeviceState:
        """Return the state before t = 0; ``zero`` is 0, (row, slot)."""
        ...

    def step(
        self,
        parameters: DeviceParams,
        state: DeviceState,
        setpoints: tuple[Array, ...],
        device_input: DeviceInput,
        dt_s: float,
    ) -> tuple[Any, Array]:
        """Advance by one interval.

        Parameters
        ----------
        parameters, state
            Parameters and the state before the interval, arrays of one kind.
        setpoints
            Setpoint of each channel except the reactive one, (row, slot) each, in the order and units of ``channels``.
        device_input
            Exogenous input, see ``input``.
        dt_s
            Length of the interval, s.

        Returns
        -------
        state, p_kw
            State at the end, and the draw from the grid, kW, (row, slot), an injection negative.
        """
        ...

    def grid_change(self, parameters: DeviceParams, state: DeviceState) -> GridChange:
        """Return changes to the grid over the interval that ends in ``state``, in addition to the device's draw."""
        ...

    def observe(self, parameters: DeviceParams, state: DeviceState, given_next: DeviceInput) -> tuple[Array, ...]:
        """Return the raw figures of the fields, (row, slot) each; ``given_next`` is the input of the next interval."""
        ...

    def amount(self, name: str, parameters: DeviceParams, state: DeviceState) -> Array:
        """Return the amount that a cost term charges, (row, slot)."""
        ...

    def totals(self, state: DeviceState) -> dict[str, Array]:
        """Return figures of all slots together for ``info``, (row,) each; see ``step_totals`` for counts of events."""
        ...

    def metrics(self, history: DeviceState, dt_s: float, requests: Requests) -> dict[str, float]:
        """Return the figures of an episode.

        Parameters
        ----------
        history
            The state's fields over time, (T + 1, slot) each, from the reset on.
        dt_s
            Length of a step, s.
        requests
            For each slot, the requests behind its work and the time in their series, s, at which the episode begins;
            None if no slot's work is made of requests.
        """
        ...


def step_totals(device: object) -> tuple[str, ...]:
    """Return the names of a group's ``totals`` that count events of a step, so a reset has none: ``step_totals``.

    A group without this attribute has no such totals.
    """
    return getattr(device, "step_totals", ())


def may_leave(device: object) -> bool:
    """Return whether devices of a group may disconnect by themselves: those with a rule, ``ride_through``.

    The ``step`` of such a group receives its usual input inside a ``ride_through.connection.Supply``. The group has a
    method ``connected`` from its state to the share of its power that is on the grid, (row, slot), by which its
    reactive power is reduced.
    """
    return getattr(device, "ride_through", None) is not None
