"""The regulators and capacitor banks of a three-phase feeder over an episode: controlled, agents, or fixed.

At the beginning of a step an agent's equipment follows the agent's action. Then the power flow is solved, and the
controls act on what they measure in it. Whenever a delay ends within the step, taps and switches change, and the power
flow is solved again (``with_controls``). At t = 0 the taps of controlled regulators have settled. Agents of set points
choose the bands of relays and the thresholds of banks that apply within the step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import ceil
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import (
    Array,
    all_true,
    any_true,
    as_like,
    min_last,
    namespace,
    put_rows,
    sum_last,
    take_last,
)
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.devices.capacitor_bank.bank_measurements import bank_settings
from dcgrid_env.devices.capacitor_bank.bank_switching import (
    Thresholds,
    bank_delays,
    initial_banks,
    measured_banks,
    next_switchings,
)
from dcgrid_env.devices.capacitor_bank.capacitor_banks import CapacitorBanks
from dcgrid_env.devices.capacitor_bank.threshold_set_points import ThresholdSetPoints
from dcgrid_env.devices.tap_changer.regulator_set_points import RegulatorSetPoints
from dcgrid_env.devices.tap_changer.regulator_state import MOST_EVENTS, SAME_TIME_S, initial_regulators
from dcgrid_env.devices.tap_changer.regulator_view import RegulatorView, regulator_view
from dcgrid_env.devices.tap_changer.relay import RelayBand, relay_volts, settings_like
from dcgrid_env.devices.tap_changer.settling import settled_taps
from dcgrid_env.devices.tap_changer.tap_changers import TapChangers
from dcgrid_env.devices.tap_changer.timed_taps import next_taps
from dcgrid_env.engine.physics.acting_relays import scenario_relays
from dcgrid_env.engine.physics.state import Equipment, over_arrays
from dcgrid_env.powerflow import Control
from dcgrid_env.powerflow.unbalanced.three_phase_solution import ThreePhaseSolution
from dcgrid_env.scenario.grid_control import capacitor_deciders, regulator_deciders
from dcgrid_env.scenario.scenario import Scenario


class _Group(NamedTuple):
    """The regulators or the banks of a feeder."""

    settings: Any
    """``RelaySettings`` or ``BankSettings``."""
    controlled: Array
    """1 where a control acts, also under set points of an agent, (n,)."""
    acts: bool
    """Whether a control acts on any of them; otherwise banks have neither measurements nor timers."""
    agents: int | None
    """Position among the scenario's devices of the group that is agents."""
    pick: Array
    """Index of each piece in the feeder's pieces followed by those of the agents, int, (n,)."""
    setters: int | None
    """Position among the scenario's devices of the group that chooses set points."""
    setter: Array
    """Index of each piece in the feeder's pieces followed by the agents that choose set points, int, (n,)."""


class _Plan(NamedTuple):
    regulators: _Group
    banks: _Group
    integrating: bool
    """Whether the timers of regulators count down in band."""


class _SetPoints(NamedTuple):
    """Set points in force over a step."""

    band: RelayBand
    thresholds: Thresholds | None
    """None where those of the settings apply."""


Solve = Callable[[Equipment, Array, Array], ThreePhaseSolution]
"""The power flow of some rows: under their equipment, at their positions (k,) int, from their ``restart``."""


def initial_equipment(
    scenario: Scenario,
    p_kw: Array,
    q_kvar: Array,
    shunt_kvar: Array | None,
    connected: Array | None,
    offset_v: Array | None,
) -> Equipment:
    """The equipment at t = 0 under the legs' net loads: taps settled, each row by itself.

    Shapes are (row, n_leg) of the loads, (row, n_node) of switched shunts, None without any, and (row, n_capacitor)
    of what is ``connected``, None where all banks are. ``offset_v`` are the offsets by schedules, None without any.
    """
    feeder, plan = _feeder(scenario), _plan(scenario, p_kw)
    zeros = 0.0 * p_kw[..., :1]
    tap, on = (zeros + _like(values, p_kw) for values in (feeder.base_tap, feeder.base_capacitor_on))
    if plan.regulators.acts:
        control = Control(None, shunt_kvar, on if connected is None else on * connected)
        regulators = plan.regulators
        tap = settled_taps(
            feeder,
            p_kw,
            q_kvar,
            scenario.source_voltage_pu,
            control,
            controlled=regulators.controlled,
            settings=regulators.settings,
            target_v=None if offset_v is None else regulators.settings.target_v + offset_v,
        ).tap
    return Equipment(initial_regulators(tap, 0.0 * tap), initial_banks(on))


def advanced(scenario: Scenario, before: Equipment, devices: Sequence[Any]) -> Equipment:
    """The equipment with which the power flow of a step begins: agents' equipment is as its agents have it.

    ``devices`` are the states of the step's devices.
    """
    regulators, banks = before
    of_regulators, of_banks, _ = _plan(scenario, regulators.tap)
    regulators = regulators._replace(moved=0.0 * regulators.moved)
    banks = banks._replace(switched=0.0 * banks.switched)
    if of_regulators.agents is not None:
        state = devices[of_regulators.agents]
        tap, moved = (_picked(of_regulators, regulators, state, name) for name in ("tap", "moved"))
        since_s = _picked(of_regulators, regulators, state._replace(since_s=state.since_s - scenario.dt_s), "since_s")
        moves = before.regulators.moves + moved
        regulators = regulators._replace(tap=tap, since_s=since_s, moved=moved, moves=moves)
    if of_banks.agents is not None:
        state = devices[of_banks.agents]
        on, switched = (_picked(of_banks, banks, state, name) for name in ("on", "switched"))
        since_s = _picked(of_banks, banks, state._replace(since_s=state.since_s - scenario.dt_s), "since_s")
        switchings = before.banks.switchings + switched
        banks = banks._replace(on=on, since_s=since_s, switched=switched, switchings=switchings)
    return Equipment(regulators, banks)


def with_controls(
    scenario: Scenario,
    equipment: Equipment,
    devices: Sequence[Any],
    offset_v: Array | None,
    solution: ThreePhaseSolution,
    solve: Solve,
) -> tuple[Equipment, ThreePhaseSolution]:
    """The equipment at the end of a step and the power flow there, from those at its beginning.

    Whenever controls act within the step, ``solve`` gives the power flow of the rows concerned. A row without a
    solution does not act any more. ``devices`` are the states of the step's devices, and ``offset_v`` the offsets of
    regulators by schedules, (row, n_regulator), or None.
    """
    equipment = measured(scenario, equipment, solution)
    plan = _plan(scenario, solution.v_pu)
    xp, left_s = namespace(solution.v_pu), 0.0 * solution.v_pu[..., :1] + scenario.dt_s
    if not (plan.regulators.acts or plan.banks.acts):
        return _waited(equipment, left_s), solution
    set_points = _set_points(scenario, plan, equipment, devices, offset_v)
    for _ in range(MOST_EVENTS):
        if not all_true(solution.converged):
            left_s = xp.where(solution.converged[..., None], left_s, 0.0 * left_s)
        before = equipment
        equipment, left_s = _next_event(scenario, plan, before, set_points, left_s)
        if not any_true(left_s[..., 0] > 0.0):
            break
        rows = xp.nonzero(_moved(before, equipment))[0]
        if len(rows):  # a control that looks again and finds its band moves nothing
            some = over_arrays(lambda values: values[rows], equipment)  # noqa: B023 (called at once)
            solved = solve(some, rows, solution.restart[rows])
            solution = over_arrays(lambda whole, new: put_rows(whole, rows, new), solution, solved)  # noqa: B023
            equipment = measured(scenario, equipment, solution)
    else:  # controls that would act without end within the step
        equipment = _waited(equipment, left_s)
    return equipment, solution


def _waited(equipment: Equipment, left_s: Array) -> Equipment:
    """The equipment after the rest of a step in which no control decides, s, (row, 1); timers that run go on."""
    (regulators, banks), xp = equipment, namespace(left_s)
    out_of_band_s, beyond_s = (
        xp.where(timer_s > 0.0, timer_s + left_s, timer_s) for timer_s in (regulators.out_of_band_s, banks.beyond_s)
    )
    return Equipment(
        regulators._replace(out_of_band_s=out_of_band_s, since_s=regulators.since_s + left_s),
        banks._replace(beyond_s=beyond_s, since_s=banks.since_s + left_s),
    )


def _next_event(
    scenario: Scenario, plan: _Plan, equipment: Equipment, set_points: _SetPoints, left_s: Array
) -> tuple[Equipment, Array]:
    """The equipment after its next event, and the time then left of the step, s, (row, 1)."""
    (regulators, banks), of_banks = equipment, plan.banks
    due_s, delay_s = left_s, None
    if of_banks.acts:
        delay_s = bank_delays(of_banks.settings, banks, of_banks.controlled, set_points.thresholds)
        due_s = min_last(delay_s)
    settings, controlled = plan.regulators.settings, plan.regulators.controlled
    regulators, passed_s = next_taps(settings, regulators, set_points.band, left_s, due_s, plan.integrating, controlled)
    if delay_s is None:
        banks = banks._replace(since_s=banks.since_s + passed_s)
    else:
        banks = next_switchings(banks, delay_s, passed_s, passed_s < left_s - SAME_TIME_S)
    return Equipment(regulators, banks), left_s - passed_s


def _moved(before: Equipment, after: Equipment) -> Array:
    """Whether any equipment of each row has moved, bool, (row,)."""
    taps = (after.regulators.moves != before.regulators.moves).any(-1)
    return taps | (after.banks.switchings != before.banks.switchings).any(-1)


def measured(scenario: Scenario, equipment: Equipment, solution: ThreePhaseSolution) -> Equipment:
    """The equipment with what it measures in a power flow; banks measure where a control goes by it."""
    plan, banks = _plan(scenario, solution.v_pu), equipment.banks
    regulators = equipment.regulators._replace(relay_v=relay_volts(plan.regulators.settings, solution))
    return Equipment(regulators, measured_banks(plan.banks.settings, solution, banks) if plan.banks.acts else banks)


def with_measurements(scenario: Scenario, devices: tuple[Any, ...], equipment: Equipment) -> tuple[Any, ...]:
    """The states of the devices, with what agents of equipment measure and what controls did under their set points."""
    (regulators, banks), after = equipment, list(devices)
    of_regulators, of_banks, *_ = _plan(scenario, regulators.relay_v)
    if (position := of_regulators.agents) is not None:
        agents: Any = scenario.devices[position]
        after[position] = after[position]._replace(relay_v=regulators.relay_v[..., list(agents.rows)])
    if (position := of_regulators.setters) is not None:
        state, band = after[position], _band(scenario, of_regulators, regulators.tap, devices)
        off_v = regulators.relay_v - band.target_v
        tap, deviation_v = (_by_setter(scenario, position, values, True) for values in (regulators.tap, off_v))
        moved = _by_setter(scenario, position, regulators.moved)
        after[position] = state._replace(mean_tap=tap, deviation_v=deviation_v, moved=moved)
    if (position := of_banks.setters) is not None:
        state = after[position]
        on, v_pu, switched = (
            _by_setter(scenario, position, values) for values in (banks.on, banks.v_pu, banks.switched)
        )
        after[position] = state._replace(bank_on=on, deviation_pu=v_pu - state.centre_pu, switched=switched)
    return tuple(after)


def _by_setter(scenario: Scenario, position: int, values: Array, is_mean: bool = False) -> Array:
    """Sum or mean of a figure over the pieces of each agent that chooses set points, (row, slot)."""
    setters: Any = scenario.devices[position]
    sums = [sum_last(values[..., list(rows)]) / (len(rows) if is_mean else 1) for rows in setters.members]
    return namespace(values).stack(sums, axis=-1)


def _set_points(
    scenario: Scenario, plan: _Plan, equipment: Equipment, devices: Sequence[Any], offset_v: Array | None
) -> _SetPoints:
    """The set points in force over a step, from the states of the step's devices and from schedules."""
    (regulators, banks), of_banks = equipment, plan.banks
    band = _band(scenario, plan.regulators, regulators.tap, devices, offset_v)
    if of_banks.setters is None:
        return _SetPoints(band, None)
    state, at_rest = devices[of_banks.setters], of_banks.settings
    on_at = _of_pieces(of_banks, 0.0 * banks.on + at_rest.on_at, state.centre_pu - state.half_width_pu)
    off_at = _of_pieces(of_banks, 0.0 * banks.on + at_rest.off_at, state.centre_pu + state.half_width_pu)
    return _SetPoints(band, Thresholds(on_at, off_at))


def _band(
    scenario: Scenario, group: _Group, tap: Array, devices: Sequence[Any], offset_v: Array | None = None
) -> RelayBand:
    """The bands of the relays in force over a step, (row, n_regulator); ``offset_v`` are the offsets by schedules."""
    if group.setters is None and offset_v is None and isinstance(tap, np.ndarray) and tap.dtype == np.float64:
        return _bands_at_rest(scenario, len(tap))
    zero = 0.0 * tap
    target_v, half_band_v = (at_rest + zero for at_rest in (group.settings.target_v, group.settings.half_band_v))
    if offset_v is not None:
        target_v = target_v + offset_v
    if group.setters is None:
        return RelayBand(target_v, half_band_v)
    setters: Any = scenario.devices[group.setters]
    state = devices[group.setters]
    chosen_v = _of_pieces(group, zero, state.offset_v - as_like(setters.parameters.rest_offset_v, tap))
    return RelayBand(target_v + chosen_v, _of_pieces(group, half_band_v, state.half_band_v))


@cached_on_owner
def _bands_at_rest(scenario: Scenario, n_row: int) -> RelayBand:
    """The bands without schedules and agents that choose set points, NumPy arrays."""
    settings = _on_numpy(scenario).regulators.settings
    return RelayBand(*(np.tile(values, (n_row, 1)) for values in (settings.target_v, settings.half_band_v)))


def _of_pieces(group: _Group, at_rest: Array, chosen: Array) -> Array:
    """A part of the set points of all pieces, (row, n), that of the setters' pieces as ``chosen`` by these."""
    return take_last(namespace(at_rest).concat((at_rest, chosen), axis=-1), group.setter)


def reported(scenario: Scenario, equipment: Equipment, devices: Sequence[Any], offset_v: Array | None) -> RegulatorView:
    """What is reported of the regulators at the end of a step; arguments as in ``with_controls``."""
    regulators, group = equipment.regulators, _plan(scenario, equipment.regulators.tap).regulators
    band = _band(scenario, group, regulators.tap, devices, offset_v)
    return regulator_view(group.settings, band, regulators)


def remembered_reports(scenario: Scenario) -> int:
    """Number of reports that a state keeps, ``State.regulator_views``; 0 where agents do not observe regulators."""
    if not scenario.sensing.regulator:
        return 0
    steps = ceil((scenario.sensing.regulator_delay_s - SAME_TIME_S) / scenario.dt_s)
    return 1 + min(max(steps, 0), scenario.horizon)


def as_control(scenario: Scenario, equipment: Equipment, connected: Array | None) -> Control:
    """Return the equipment as a control of the power flow; ``connected`` banks are as in ``initial_equipment``."""
    on = equipment.banks.on
    ratio = _feeder(scenario).tap_ratio(equipment.regulators.tap)
    return Control(ratio, None, on if connected is None else on * connected)


def _picked(group: _Group, state: object, commanded: object, name: str) -> Array:
    """A figure of all pieces, that of the agents out of the state of their group."""
    both = (getattr(state, name), getattr(commanded, name))
    return take_last(namespace(both[0]).concat(both, axis=-1), group.pick)


def _plan(scenario: Scenario, like: Array) -> _Plan:
    """The plan as arrays of the kind, precision and device of ``like``; made once for each."""
    if isinstance(like, np.ndarray) and like.dtype == np.float64:
        return _on_numpy(scenario)
    return _build_plan(scenario, namespace(like), like.dtype, like.device)


@cached_on_owner
def _on_numpy(scenario: Scenario) -> _Plan:
    like = np.empty(0)
    return _build_plan(scenario, np, like.dtype, like.device)


@cached_on_owner
def _build_plan(scenario: Scenario, xp: ModuleType, dtype: object, device: object) -> _Plan:
    feeder, like = _feeder(scenario), xp.zeros(0, dtype=dtype, device=device)
    kinds = [kind.kind for kind in scenario.devices]
    groups: list[_Group] = []
    control = scenario.grid_control
    of_regulators, of_banks = regulator_deciders(control, feeder), capacitor_deciders(control, feeder)
    banks = bank_settings(feeder, control.capacitor_settings, [by == "controlled" for by in of_banks])
    for settings, decides, kind, setter_kind in (
        (scenario_relays(scenario), of_regulators, TapChangers, RegulatorSetPoints),
        (banks, of_banks, CapacitorBanks, ThresholdSetPoints),
    ):
        controlled = np.array([decider in ("controlled", "setpoint") for decider in decides], np.float64)
        position, setters = (
            kinds.index(device_class.kind) if device_class.kind in kinds else None
            for device_class in (kind, setter_kind)
        )
        pick, setter = np.arange(len(decides)), np.arange(len(decides))
        if position is not None:
            agents: Any = scenario.devices[position]
            pick[list(agents.rows)] = len(decides) + np.arange(agents.count)
        if setters is not None:
            choosing: Any = scenario.devices[setters]
            for slot, rows in enumerate(choosing.members):
                setter[list(rows)] = len(decides) + slot
        settings, acts = settings_like(settings, like), bool(controlled.any())
        pick, setter = (xp.asarray(indices, device=device) for indices in (pick, setter))
        groups.append(_Group(settings, _like(controlled, like), acts, position, pick, setters, setter))
    timer, (regulators, banks) = scenario.grid_control.regulator_settings.timer, groups
    return _Plan(regulators, banks, timer == "integrating")


def _feeder(scenario: Scenario) -> Any:
    """The scenario's feeder, which has three phases."""
    return scenario.feeder


def _like(values: Array, like: Array) -> Array:
    return namespace(like).asarray(np.array(values, np.float64), dtype=like.dtype, device=like.device)
