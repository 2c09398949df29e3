"""Measurement of a voltage regulator's relay, and the direction of the tap change that it demands.

    relay volts = |V / PT - (R + jX) I / CT|        out of band where off from ``vreg_v`` by more than half the band

V is the voltage of the winding of the sensed phase at the regulator's to-bus, to ground or to another node, or that of
another bus, and I the current through that phase. R and X are the settings of the line-drop compensator in volts. CT is
the primary rating of its current transformer in A (W. H. Kersting, "Distribution System Modeling and Analysis",
chapter 7). Compensation by magnitudes has |V / PT| - Z |I| / CT instead. Half the band is at least half a tap: with a
narrower band the regulator would switch back and forth without end.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, as_like, namespace, take_last
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.formula import compiled_as
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.powerflow.unbalanced.three_phase_solution import ThreePhaseSolution


class RelaySettings(NamedTuple):
    """The regulators' table as arrays over its rows, (n_regulator,) where no other shape is given."""

    node: Array
    """Sensed node, int."""
    other: Array
    """Node at the other end of the winding, int; ``node`` if that end is grounded."""
    is_between: Array
    """1 for a winding to another node, 0 to ground."""
    volts_per_pu: Array
    """Relay volts at 1 p.u. of the sensed node."""
    r_ohm: Array
    """Relay volts a primary ampere of the line-drop compensator, in phase with the current."""
    x_ohm: Array
    """Those ahead of it by 90 degrees."""
    z_ohm: Array
    """Those of the compensation by magnitudes."""
    target_v: Array
    half_band_v: Array
    delay_s: Array
    """Before the first tap."""
    tap_delay_s: Array
    """Between further ones."""
    lowest: Array
    """Lowest tap; that of the table for a fixed tap, like ``highest`` (``max_taps_per_move`` 0)."""
    highest: Array
    volts_per_tap: Array
    """Change of the column regulator's relay volts per tap of the row regulator, (n_regulator, n_regulator).

    It applies at nominal voltage, and is 0 where the row regulator does not feed the column one in the sensed phase.
    """


class RelayBand(NamedTuple):
    """Bands of relays that are in force in each environment, (row, n_regulator) each."""

    target_v: Array
    half_band_v: Array


@cached_on_owner
def relay_settings(feeder: ThreePhaseFeeder) -> RelaySettings:
    """The settings of a feeder's regulators, NumPy arrays."""
    table = feeder.network.regulator
    node = np.array(
        [feeder.nodes_of(table.relay_bus(row), phase)[0] for row, phase in enumerate(table.sensed_phase)], np.int64
    )
    pt, ct, step = (np.array(column, np.float64) for column in (table.pt_ratio, table.ct_primary_a, table.tap_step))
    other = _other_ends(feeder, node)
    nominal_v = np.array(table.kv_ln, np.float64) * 1000.0 / pt
    moves = np.array(table.max_taps_per_move) > 0
    volts_per_tap = _feeds(feeder, node) * step[:, None] * nominal_v
    return RelaySettings(
        node=node,
        other=np.where(other < 0, node, other),
        is_between=(other >= 0).astype(np.float64),
        volts_per_pu=feeder.base_kv_ln[feeder.node_bus[node]] * 1000.0 / pt,
        r_ohm=np.array(table.r_ldc_v) / ct,
        x_ohm=np.array(table.x_ldc_v) / ct,
        z_ohm=np.array(table.z_ldc_v or np.zeros(len(table))) / ct,
        target_v=np.array(table.vreg_v, np.float64),
        half_band_v=0.5 * np.maximum(np.array(table.band_v, np.float64), step * nominal_v),
        delay_s=np.array(table.delay_s, np.float64),
        tap_delay_s=np.array(table.tap_delay_s, np.float64),
        lowest=np.where(moves, table.tap_min, table.tap).astype(np.float64),
        highest=np.where(moves, table.tap_max, table.tap).astype(np.float64),
        volts_per_tap=volts_per_tap,
    )


def _other_ends(feeder: ThreePhaseFeeder, node: np.ndarray) -> np.ndarray:
    """Node at the other end of the winding that each relay measures, -1 if it is grounded."""
    table, other_nodes = feeder.network.regulator, np.full(len(node), -1, np.int64)
    for row, (bus, phase) in enumerate(zip(table.to_bus, table.sensed_phase, strict=True)):
        winding = next((at_to for _, at_to in table.windings(row) if phase in at_to), "")
        if len(winding) > 1 and table.relay_bus(row) == bus:
            other_nodes[row] = feeder.nodes_of(bus, winding.replace(phase, ""))[0]
    return other_nodes


def _feeds(feeder: ThreePhaseFeeder, node: np.ndarray) -> np.ndarray:
    """Return 1 where the row regulator is the column regulator or is between it and the source in its sensed phase."""
    feeds = np.zeros((len(node), len(node)))
    for column, upstream in enumerate(node):
        while upstream >= 0:
            row = feeder.node_regulator[upstream]
            if row >= 0:
                feeds[row, column] = 1.0
            upstream = feeder.node_parent[upstream]
    return feeds


def settings_like(settings: Any, like: Array) -> Any:
    """Settings as arrays of the kind, precision and device of ``like``; whole numbers stay such."""
    if isinstance(like, np.ndarray) and like.dtype == np.float64:
        return settings
    xp = namespace(like)
    return type(settings)(
        *(
            xp.asarray(values.copy(), device=like.device) if values.dtype.kind == "i" else as_like(values.copy(), like)
            for values in settings
        )
    )


def relay_volts(settings: RelaySettings, solution: ThreePhaseSolution) -> Array:
    """Relay volts of each regulator, (..., n_regulator), of a ``ThreePhaseSolution`` of its feeder."""
    return _relay_volts(settings, solution.v_re_pu, solution.v_im_pu, solution.i_re_a, solution.i_im_a)


@compiled_as("dcgrid_env.devices.tap_changer.tap_kernels:relay_volts", like="v_re_pu")
def _relay_volts(settings: RelaySettings, v_re_pu: Array, v_im_pu: Array, i_re_a: Array, i_im_a: Array) -> Array:
    """See ``relay_volts``; voltages and currents of all nodes, (..., n_node)."""
    v_re, v_im, i_re, i_im = (take_last(values, settings.node) for values in (v_re_pu, v_im_pu, i_re_a, i_im_a))
    v_re, v_im = (
        v - settings.is_between * take_last(node_v, settings.other) for v, node_v in ((v_re, v_re_pu), (v_im, v_im_pu))
    )
    re = v_re * settings.volts_per_pu - settings.r_ohm * i_re + settings.x_ohm * i_im
    im = v_im * settings.volts_per_pu - settings.r_ohm * i_im - settings.x_ohm * i_re
    return namespace(re).hypot(re, im) - settings.z_ohm * namespace(re).hypot(i_re, i_im)


def direction(settings: RelaySettings, relay_v: Array, tap: Array) -> Array:
    """1 for a regulator that is to go up by a tap, -1 for one down, 0 for one in its band or at its end, as ``tap``."""
    missing_v = settings.target_v - relay_v
    up = (missing_v > settings.half_band_v) & (tap < settings.highest)
    down = (missing_v < -settings.half_band_v) & (tap > settings.lowest)
    xp = namespace(tap)
    return xp.astype(up, tap.dtype) - xp.astype(down, tap.dtype)
