"""The feeder on the replay page: positions of buses, branches, agents, equipment and their names."""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env.devices.grid_equipment import is_equipment
from dcgrid_env.engine.record.episode_record import Series
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.rendering.bus_positions import positions
from dcgrid_env.rendering.equipment_labels import banks_of
from dcgrid_env.rendering.feeder_map import Room, agent_colour, fed_through
from dcgrid_env.rendering.replay_course import of_devices

_WIDTH_PX, _HEIGHTS_PX = 380.0, (190.0, 340.0)
"""A small map, on which names are given their room; on a larger one they have more."""
_MARGIN_PX, _STRETCH = 26.0, 1.6
"""What is left free around the feeder, and how far one axis may be drawn larger than the other; as in feeder_map.js."""
_LETTER_PX = 13.0
_REACH_PX = 15.0
"""How far the rings of a device reach from its bus."""
_WIDTHS = 3
"""Widths in which branches are drawn, by the load behind them."""


def feeder_map(run: Series) -> dict[str, Any]:
    """What is the same in every step and under every controller."""
    feeder: Any = run.scenario.feeder
    xy = positions(feeder)
    xy = (xy - xy.min(axis=0)) / (np.ptp(xy, axis=0).max() or 1.0)
    three_phase = isinstance(feeder, ThreePhaseFeeder)
    share = np.sqrt(fed_through(feeder) / (fed_through(feeder).max() or 1.0))
    room = _room(feeder, xy)
    return {
        "buses": {
            "id": [str(bus) for bus in feeder.bus_ids],
            "x": _rounded(xy[:, 0]),
            "y": _rounded(xy[:, 1]),
            "width": np.minimum(share * _WIDTHS, _WIDTHS - 1).astype(int).tolist(),
        },
        "parent": np.asarray(feeder.parent).tolist(),
        "loops": [] if three_phase or feeder.loop_ends is None else feeder.loop_ends.tolist(),
        "nodes": {
            "bus": np.asarray(feeder.node_bus).tolist(),
            "phase": [int(phase) - 1 for phase in feeder.node_phase] if three_phase else None,
        },
        "judged": np.asarray(feeder.load_nodes).tolist(),
        "agents": _agents(run, room),
        "banks": _banks(feeder, room) if three_phase else [],
        "capacitors": _capacitors(feeder, room) if three_phase else [],
    }


def _rounded(values: np.ndarray) -> list[float]:
    return [round(float(value), 4) for value in values]


def _room(feeder: Any, xy: np.ndarray) -> Room:
    """What is taken on a small map, in pixels from its lower left corner."""
    span = np.maximum(np.ptp(xy, axis=0), 1e-9)
    inner = _WIDTH_PX - 2 * _MARGIN_PX
    height = np.clip(inner * _STRETCH * span[1] / span[0] + 2 * _MARGIN_PX, *_HEIGHTS_PX)
    size = np.array([_WIDTH_PX, float(height)])
    unit = span / (size - 2 * _MARGIN_PX)
    unit = np.maximum(unit, unit.max() / _STRETCH)
    xy_scaled = (xy - 0.5 * (xy.min(axis=0) + xy.max(axis=0))) / unit + 0.5 * size
    radius = np.full(len(xy), 8.0 if isinstance(feeder, ThreePhaseFeeder) else 6.0)
    return Room(xy_scaled, radius, feeder.parent, np.stack((0.0 * size, size)), False)


def _agents(run: Series, room: Room) -> list[dict[str, Any]]:
    s = run.scenario
    entries: list[dict[str, Any]] = []
    for device, _, agents in of_devices(run):
        works = device.input == "workload"
        for slot, i in enumerate(agents):
            one = {"id": s.agents[i], "kind": device.kind, "site": works, "equipment": is_equipment(device)}
            if not one["equipment"]:
                bus = int(run.buses[i])
                one |= {"bus": bus, "colour": agent_colour(slot) if works else "#4D4D4D"}
                room.radius[bus] = _REACH_PX
            if works:
                dc = device.parameters
                one |= {"f_max_mhz": float(dc.f_max_mhz[slot]), "p_rated_kw": float(dc.p_rated_kw[slot])}
            entries.append(one)
    # Sites first: they are given the best places.
    for one in sorted(entries, key=lambda one: not one["site"]):
        if not one["equipment"]:
            one["name"] = one["id"]
            one["at"] = _rounded(room.take(one["bus"], len(one["name"]), _LETTER_PX))
    return entries


def _banks(feeder: Any, room: Room) -> list[dict[str, Any]]:
    phases = feeder.network.regulator.phases
    return [
        {
            "name": bank.name,
            "bus": bank.bus,
            "rows": list(bank.rows),
            "phases": [str(phases[row]) for row in bank.rows],
            "at": _rounded(room.take(bank.bus, len(bank.name) + 4 * len(bank.rows), 9.0, 1.6, led=True)),
        }
        for bank in banks_of(feeder)
    ]


def _capacitors(feeder: Any, room: Room) -> list[dict[str, Any]]:
    table = feeder.network.capacitor
    capacitors = []
    for row, (name, of_bank) in enumerate(zip(table.name, table.bus, strict=True)):
        bus = feeder.index(of_bank)
        label_xy = _rounded(room.take(bus, len(str(name)) + 4, 9.0, 1.6, led=True))
        capacitors.append({"name": str(name), "bus": bus, "row": row, "at": label_xy})
    return capacitors
