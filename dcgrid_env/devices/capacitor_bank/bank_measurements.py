"""What the built-in controls of capacitor banks measure, and at which values they switch.

A bank in mode ``controlled`` with a row in the feeder's table of capacitor controls has the settings of this row. The
others have those of the scenario (``CapacitorControl``). Either becomes a column of ``BankSettings``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from math import lcm
from typing import NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, min_last, namespace, sum_last, take_last
from dcgrid_env.devices.capacitor_bank.capacitor_control import CapacitorControl
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.grid.three_phase_tables import CONTROL_MEASURES, STATISTICS
from dcgrid_env.powerflow.unbalanced.three_phase_solution import ThreePhaseSolution

VOLTAGE, CURRENT, KVAR, POWER_FACTOR = range(len(CONTROL_MEASURES))


class BankSettings(NamedTuple):
    """Settings of a feeder's banks, in the order of their table, (n_capacitor,) where no other shape is given.

    A bank has k places to measure voltage and k to measure current; one with fewer has each of them several times.
    """

    measures: Array
    """Position in ``CONTROL_MEASURES``."""
    node: Array
    """Nodes of the measured voltages, int, (k n_capacitor,)."""
    other: Array
    """Nodes of their other ends, int, (k n_capacitor,); ``node`` if that end is grounded."""
    is_between: Array
    """1 for a voltage between two nodes, 0 to ground, (n_capacitor, k)."""
    volts_of: Array
    """Position in ``STATISTICS`` of what counts of the voltages."""
    meter_node: Array
    """Nodes of the measured currents, int, (k n_capacitor,); none if no bank measures current."""
    fed_node: Array
    """Nodes that these currents are brought to, int, (k n_capacitor,)."""
    sign: Array
    """1 where such a current leaves ``meter_node``, and -1 where it comes, (n_capacitor, k)."""
    charging_node: Array
    """Nodes whose voltages charge the line at this end, int, (3 k n_capacitor,)."""
    charging_a_per_pu: Array
    """Charging by 1 p.u., (n_capacitor, k, 3)."""
    amps_of: Array
    """Position in ``STATISTICS`` of what counts of the currents."""
    kvar_per_pu_a: Array
    """Kvar of 1 p.u. of voltage and 1 A in quadrature in all places, in the unit of the thresholds."""
    least_kvar: Array
    """Reactive power below which the power factor does not switch on."""
    on_at: Array
    """Threshold of switching on: p.u. of the base voltage to ground, A, kvar or a power factor."""
    off_at: Array
    is_low: Array
    """1 for a bank that switches on below its threshold, -1 for one that does so above it."""
    low_pu: Array
    """Voltage below which it switches on in any case, p.u."""
    high_pu: Array
    """Voltage above which it switches off in any case, p.u."""
    delay_on_s: Array
    delay_off_s: Array
    dead_time_s: Array
    before: Array
    """Bank that is on before this one switches on, int; this one itself if there is none."""
    behind: Array
    """Bank that is off before this one switches off, int; this one itself if there is none."""


class _Bank(NamedTuple):
    """A column of ``BankSettings``, its places not yet repeated."""

    measures: int
    legs: Sequence[tuple[int, int]]
    """Ends of the voltages, the second of them -1 for ground."""
    volts_of: int
    meter_node: np.ndarray
    fed_node: np.ndarray
    sign: np.ndarray
    charging_node: np.ndarray
    charging: np.ndarray
    amps_of: int
    kvar_unit: float
    """Kvar that the thresholds count in."""
    least_kvar: float
    on_at: float
    off_at: float
    low_pu: float
    high_pu: float
    delay_on_s: float
    delay_off_s: float
    dead_time_s: float


def bank_settings(feeder: ThreePhaseFeeder, control: CapacitorControl, controlled: Sequence[bool]) -> BankSettings:
    """The settings of a feeder's banks, NumPy arrays.

    Parameters
    ----------
    feeder
        The feeder.
    control
        Settings of the scenario, for the banks without own ones.
    controlled
        Whether a bank is in mode ``controlled``, in which its own settings apply.
    """
    table = feeder.network.capacitor_control
    rows = dict(zip(table.capacitor, range(len(table)), strict=True))
    names = feeder.network.capacitor.name
    banks = [
        _of_table(feeder, rows[name]) if is_controlled and name in rows else _of_scenario(feeder, k, control)
        for k, (name, is_controlled) in enumerate(zip(names, controlled, strict=True))
    ]
    k = lcm(*(len(places) for bank in banks for places in (bank.legs, bank.meter_node)))
    legs = [np.tile(np.array(bank.legs, np.int64).reshape(-1, 2), (k // len(bank.legs), 1)) for bank in banks]
    ends = np.array(legs, np.int64).reshape(-1, 2)
    has_meter = any(bank.measures != VOLTAGE for bank in banks)

    def tiled(field: str) -> np.ndarray:
        columns = [np.asarray(getattr(bank, field)) for bank in banks if has_meter]
        return np.array([np.tile(column, (k // len(column), *[1] * (column.ndim - 1))) for column in columns])

    def column(field: str) -> np.ndarray:
        return np.array([getattr(bank, field) for bank in banks], np.float64)

    nodes = {field: tiled(field).astype(np.int64).reshape(-1) for field in ("meter_node", "fed_node", "charging_node")}
    base_kv = feeder.base_kv_ln[feeder.node_bus]
    units = [base_kv[bank.meter_node[0]] * len(bank.meter_node) / bank.kvar_unit for bank in banks]
    position = {name: row for row, name in enumerate(names)}
    before = np.arange(len(banks))
    for name, after, is_controlled in zip(names, _after(feeder), controlled, strict=True):
        if after and is_controlled:
            before[position[name]] = position[after]
    behind = np.arange(len(banks))
    for row in np.flatnonzero(before != behind):
        behind[before[row]] = row
    is_low = np.array([1.0 if bank.measures in (VOLTAGE, POWER_FACTOR) else -1.0 for bank in banks])
    return BankSettings(
        measures=column("measures"),
        node=ends[:, 0],
        other=np.where(ends[:, 1] < 0, ends[:, 0], ends[:, 1]),
        is_between=(ends[:, 1] >= 0).astype(np.float64).reshape(len(banks), k),
        volts_of=column("volts_of"),
        sign=tiled("sign").reshape(-1, k),
        charging_a_per_pu=tiled("charging").reshape(-1, k, 3),
        amps_of=column("amps_of"),
        kvar_per_pu_a=np.array(units),
        least_kvar=column("least_kvar"),
        on_at=column("on_at"),
        off_at=column("off_at"),
        is_low=is_low,
        low_pu=column("low_pu"),
        high_pu=column("high_pu"),
        delay_on_s=column("delay_on_s"),
        delay_off_s=column("delay_off_s"),
        dead_time_s=column("dead_time_s"),
        before=before,
        behind=behind,
        **nodes,
    )


def _after(feeder: ThreePhaseFeeder) -> list[str]:
    """The bank that each bank of the feeder comes after, or an empty text."""
    table = feeder.network.capacitor_control
    named = dict(zip(table.capacitor, table.after, strict=True)) if table.after else {}
    return [named.get(name, "") for name in feeder.network.capacitor.name]


def _of_scenario(feeder: ThreePhaseFeeder, row: int, control: CapacitorControl) -> _Bank:
    """A bank with the settings of the scenario: at its own nodes."""
    legs, table = feeder.capacitor_legs, feeder.network.capacitor
    nodes = np.unique(np.concatenate((legs.node[legs.row == row], legs.other[legs.row == row])))
    nodes = nodes[nodes >= 0]
    nodes = nodes if len(nodes) else np.zeros(1, np.int64)  # a bank of no kvar
    is_voltage = control.measures == "voltage"
    return _Bank(
        measures=VOLTAGE if is_voltage else KVAR,
        legs=[(int(node), -1) for node in nodes],
        volts_of=0,
        meter_node=nodes,
        fed_node=nodes,
        sign=np.ones(len(nodes)),
        charging_node=np.repeat(nodes[:, None], 3, axis=1),
        charging=np.zeros((len(nodes), 3)),
        amps_of=0,
        kvar_unit=sum(table.kvar[row]) or math.inf,
        least_kvar=-math.inf,
        on_at=control.on_below_pu if is_voltage else control.on_above_share,
        off_at=control.off_above_pu if is_voltage else control.off_below_share,
        low_pu=-math.inf,
        high_pu=math.inf,
        delay_on_s=control.delay_s,
        delay_off_s=control.delay_s,
        dead_time_s=0.0,
    )


def _of_table(feeder: ThreePhaseFeeder, row: int) -> _Bank:
    """A bank with a row in the table of capacitor controls."""
    table, meter = feeder.network.capacitor_control, feeder.capacitor_meters[row]
    ends = [feeder.nodes_of(table.bus[row], leg) for leg in table.legs[row].split()]
    per_volt = table.pt_ratio[row] / (1000.0 * feeder.base_kv_ln[feeder.index(table.bus[row])])
    measures = CONTROL_MEASURES.index(table.measures[row])
    unit = {VOLTAGE: per_volt, CURRENT: table.ct_ratio[row]}.get(measures, 1.0)
    low_pu, high_pu, least_kvar = (
        if_none if not values or math.isnan(values[row]) else values[row] * scale
        for values, if_none, scale in (
            (table.low_v, -math.inf, per_volt),
            (table.high_v, math.inf, per_volt),
            (table.least_kvar, -math.inf, 1.0),
        )
    )
    nodes = np.array([ends[0][0]]) if meter is None else meter.node
    return _Bank(
        measures=measures,
        legs=[(end[0], end[1] if len(end) > 1 else -1) for end in ends],
        volts_of=STATISTICS.index(table.legs_of[row]),
        meter_node=nodes,
        fed_node=nodes if meter is None else meter.fed_node,
        sign=np.ones(1) if meter is None else meter.sign,
        charging_node=np.repeat(nodes[:, None], 3, axis=1) if meter is None else meter.charging_node,
        charging=np.zeros((1, 3)) if meter is None else meter.charging_a_per_pu,
        amps_of=STATISTICS.index(table.phases_of[row]),
        kvar_unit=1.0,
        least_kvar=least_kvar,
        on_at=table.on_at[row] * unit,
        off_at=table.off_at[row] * unit,
        low_pu=low_pu,
        high_pu=high_pu,
        delay_on_s=table.delay_on_s[row],
        delay_off_s=table.delay_off_s[row],
        dead_time_s=table.dead_time_s[row],
    )


def measured(settings: BankSettings, solution: ThreePhaseSolution, on: Array) -> tuple[Array, Array]:
    """Voltage of each bank, p.u., and what its thresholds apply to, (row, n_capacitor) each.

    ``on`` is whether the banks are on, (row, n_capacitor).
    """
    v_re, v_im = (take_last(values, settings.node) for values in (solution.v_re_pu, solution.v_im_pu))
    if bool((settings.is_between > 0.0).any()):
        is_between = settings.is_between.reshape(-1)
        v_re = v_re - is_between * take_last(solution.v_re_pu, settings.other)
        v_im = v_im - is_between * take_last(solution.v_im_pu, settings.other)
        volts = namespace(v_re).hypot(v_re, v_im)
    else:
        volts = take_last(solution.v_pu, settings.node)
    v_pu = _of_places(volts.reshape((*on.shape, -1)), settings.volts_of)
    return v_pu, v_pu if not len(settings.meter_node) else _through(settings, solution, on, v_pu)


def _through(settings: BankSettings, solution: ThreePhaseSolution, on: Array, v_pu: Array) -> Array:
    """What the thresholds apply to if some banks measure current or power."""
    shape, xp = (*on.shape, -1), namespace(on)
    places = settings.meter_node
    v_re, v_im = (take_last(values, places).reshape(shape) for values in (solution.v_re_pu, solution.v_im_pu))
    i_re, i_im = (
        settings.sign * take_last(values, settings.fed_node).reshape(shape)
        for values in (solution.i_re_a, solution.i_im_a)
    )
    if bool((settings.charging_a_per_pu != 0.0).any()):
        charging = tuple(
            sum_last(settings.charging_a_per_pu * take_last(values, settings.charging_node).reshape((*v_re.shape, 3)))
            for values in (solution.v_re_pu, solution.v_im_pu)
        )
        i_re, i_im = i_re - charging[1], i_im + charging[0]
    k = v_re.shape[-1]
    kvar = (v_im * i_re - v_re * i_im).sum(-1) / k * settings.kvar_per_pu_a
    kw = (v_re * i_re + v_im * i_im).sum(-1) / k * settings.kvar_per_pu_a
    kva = xp.hypot(kw, kvar)
    factor = xp.abs(kw) / xp.where(kva > 0.0, kva, 0.0 * kva + 1.0)
    factor = xp.where(kva > 0.0, factor, 0.0 * kva + 1.0)
    factor = xp.where(kvar < 0.0, 2.0 - factor, factor)
    too_little = (on < 0.5) & (kvar <= settings.least_kvar)
    factor = xp.where(too_little, xp.maximum(factor, settings.on_at + 0.0 * factor), factor)
    amps = _of_places(xp.hypot(i_re, i_im), settings.amps_of)
    value = v_pu
    for measures, figure in ((CURRENT, amps), (KVAR, kvar), (POWER_FACTOR, factor)):
        value = xp.where(settings.measures == measures, figure, value)
    return value


def _of_places(values: Array, statistic: Array) -> Array:
    """Mean, largest or smallest of the places of each bank, (row, n_capacitor), of values (row, n_capacitor, k)."""
    xp = namespace(values)
    combined = values.sum(-1) / values.shape[-1]
    if bool((statistic > 0.0).any()):
        combined = xp.where(statistic == 1.0, -min_last(-values)[..., 0], combined)
        combined = xp.where(statistic == 2.0, min_last(values)[..., 0], combined)
    return combined
