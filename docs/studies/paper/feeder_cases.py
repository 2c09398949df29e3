"""Forms of the IEEE 123 node feeder that the study compares; each adds one thing to the previous one."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

from dcgrid_env import ThreePhaseFeeder, load_feeder
from dcgrid_env.apps.reproduction.paper import PUBLISHED_BUSES
from dcgrid_env.apps.reproduction.study_runs import Setting

BALANCED, TRUE = "ieee123", "ieee123-3ph-published"
"""Scenarios of the study: the balanced equivalent and the feeder with its phases."""
FEEDER = "ieee123-3ph"
"""Feeder of the second."""
SUBSTATION = "reg1a"
"""The bank of regulators that the equivalent has too, as the voltage of its substation."""


class Case(NamedTuple):
    """A form of the feeder."""

    label: str
    about: str
    scenario: str
    fields: dict[str, Any]


def cases() -> dict[str, Case]:
    """The forms by name, in the order in which each adds one thing to the one before."""
    fixed = {"grid_control.regulators": "fixed"}
    return {
        "balanced": Case("balanced", f"`{BALANCED}`, the balanced single-phase equivalent", BALANCED, {}),
        "phases": Case(
            "with phases",
            f"`{TRUE}` with the line regulators, which the equivalent lacks, at neutral",
            TRUE,
            fixed | {"feeder": without_line_regulators()},
        ),
        "fixed": Case("fixed taps", f"`{TRUE}` with all regulators fixed at their published taps", TRUE, fixed),
        "acting": Case("acting", f"`{TRUE}` unchanged, with regulators under their local control", TRUE, {}),
    }


def without_line_regulators() -> ThreePhaseFeeder:
    """The feeder with its phases, all regulators but the substation's at neutral."""
    network = load_feeder(FEEDER).network
    table = network.regulator
    tap = tuple(
        tap if bank == SUBSTATION else neutral
        for bank, tap, neutral in zip(table.bank, table.tap, table.tap_neutral, strict=True)
    )
    return ThreePhaseFeeder.from_network(dataclasses.replace(network, regulator=dataclasses.replace(table, tap=tap)))


def common_sites() -> tuple[int, ...]:
    """Return the three-phase buses of the public code, where a balanced load is possible on both feeders."""
    feeder = load_feeder(FEEDER)
    return tuple(bus for bus in PUBLISHED_BUSES if feeder.bus_phases[feeder.index(bus)] == "abc")


def setting_of(case: Case, setting: Setting) -> Setting:
    """The setting on a form of the feeder, sites that are not drawn at :func:`common_sites`."""
    return dataclasses.replace(
        setting, base=case.scenario, fields={**setting.fields, **case.fields}, sites=common_sites()
    )
