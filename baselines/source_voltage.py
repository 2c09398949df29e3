"""The voltage of a feeder's source: where it comes from, and the choice of one that centres the voltages.

A feeder keeps the voltage of its file. Most published feeders specify 1 p.u., at which all their voltages are below
1 p.u. A learner would then be rewarded for compensating a badly chosen tap. On request the source is set as a tap
changer would set it, and also for bundled feeders that leave the band without any device. The mean voltages of the
buses over episodes without control then extend as far above 1 p.u. as below it. If automatic regulators act on the
feeder, they control its voltages, and the source is left unchanged. The effect of the rule on costs is described in
docs/own-feeder.md.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env import Feeder, RandomFeeders, Scenario, acting_relays, solver_for
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.baselines.rollout import rollout
from dcgrid_env.grid import is_bundled
from dcgrid_env.traces import WHOLE

CENTRED = "centred"
"""Value of ``source_voltage_pu`` on the command line and in study files that asks for ``centred_voltage``."""
TAP_PU = 0.00625
"""Voltage of one tap, p.u.; regulators and tap changers usually have 32 taps for +-10 %."""
EPISODES = 8
"""Number of episodes of the training split that the mean is taken over."""
LONGEST = 600
"""Maximum number of steps of an episode that are simulated."""
_ROUNDS = 4


class SourceVoltage(NamedTuple):
    """A substation voltage and the resulting bus voltages."""

    v_pu: float
    lowest_pu: float
    """Lowest of the buses' mean voltages without control, p.u."""
    highest_pu: float
    """Highest of the buses' mean voltages without control, p.u."""


def centred_voltage(scenario: Scenario, episodes: int = EPISODES) -> SourceVoltage:
    """Find the substation voltage, on whole taps and within the scenario's band, that centres the mean voltages.

    Parameters
    ----------
    scenario
        Any scenario; the episodes are of its training split, or of the split whole if it is on that.
    episodes
        How many, of seeds 0, 1, ..
    """
    if acting_relays(scenario) is not None:
        return SourceVoltage(scenario.source_voltage_pu, *_reach(scenario, scenario.source_voltage_pu, episodes))
    taps = int(scenario.cost.band_pu / TAP_PU + 1e-9)
    tap, tried = taps, dict[int, tuple[float, float]]()  # from the top, where a power flow has most room
    for _ in range(_ROUNDS):
        tried[tap] = lowest, highest = _reach(scenario, 1.0 + tap * TAP_PU, episodes)
        nearer = int(np.clip(tap + round((1.0 - 0.5 * (lowest + highest)) / TAP_PU), -taps, taps))
        if nearer in tried:
            break
        tap = nearer
    best = min(tried, key=lambda tap: abs(sum(tried[tap]) - 2.0))
    return SourceVoltage(1.0 + best * TAP_PU, *tried[best])


def default_voltage(scenario: Scenario) -> Scenario:
    """Return a scenario at the source voltage of its feeder, or on some bundled feeders at the centred one.

    Only a bundled feeder whose published case leaves the scenario's band by itself, without regulators that act, has a
    centred voltage.
    """
    feeder = scenario.feeder
    if not is_bundled(feeder) or acting_relays(scenario) is not None or not _leaves_band(scenario):
        return scenario.replace(source_voltage_pu=feeder.v0_pu)
    return scenario.replace(source_voltage_pu=centred_voltage(scenario).v_pu)


def source_origin(scenario: Scenario, requested: object = None, name: str | None = None, place: str = "--set") -> str:
    """Return where a scenario's source voltage comes from, in words.

    Parameters
    ----------
    scenario
        The scenario.
    requested
        The user's value of ``source_voltage_pu``, or ``CENTRED``; None for none.
    name
        Scenario that the user named; None if the devices were chosen for the feeder.
    place
        Where the user sets ``source_voltage_pu``.
    """
    feeder: Any = scenario.feeder
    if isinstance(feeder, RandomFeeders):
        return f"set by {place}" if requested is not None else f"from scenario {name}"
    bundled = is_bundled(feeder)
    file = f"the bundled feeder {feeder.name}" if bundled else f"the file of feeder {feeder.name}"
    if feeder.folder is not None and not bundled:
        file = f"{feeder.folder.name}/feeder.toml"
    has = f"{file} has {feeder.v0_pu:.6g} p.u."
    if requested == CENTRED and acting_relays(scenario) is not None:
        kept = source_origin(scenario, None, name, place)
        return f"{kept}, not {CENTRED} as {place} asks, because regulators act"
    if requested == CENTRED:
        return f"{CENTRED} as {place} asks; {has}"
    if requested is not None:
        return f"set by {place}; {has}"
    if scenario.source_voltage_pu == feeder.v0_pu:
        return f"from {file}"
    if name is not None:
        return f"from scenario {name}; {has}"
    low, high = 1.0 - scenario.cost.band_pu, 1.0 + scenario.cost.band_pu
    return f"{CENTRED}, because {file} leaves {low:g} to {high:g} p.u. by itself at its {feeder.v0_pu:.6g} p.u."


def source_line(scenario: Scenario, origin: str) -> str:
    """Return a line with a scenario's source voltage and where it comes from, as ``source_origin`` says it."""
    return f"source at {scenario.source_voltage_pu:.6g} p.u., {origin}"


def _leaves_band(scenario: Scenario) -> bool:
    """Whether a bus is outside the band at nominal load, without devices, at the feeder's source voltage."""
    feeder: Any = scenario.feeder
    q_kvar = feeder.q_load_kvar
    if isinstance(feeder, Feeder) and scenario.background.capacitors:  # three-phase feeders have a table of their banks
        q_kvar = q_kvar - feeder.capacitor_kvar
    solution = solver_for(feeder, scenario.power_flow)(feeder, feeder.p_load_kw, q_kvar, feeder.v0_pu)
    v_pu = np.asarray(solution.v_pu)[..., feeder.load_slice]
    return not np.all(np.abs(v_pu - 1.0) <= scenario.cost.band_pu)


def _reach(scenario: Scenario, v_pu: float, episodes: int) -> tuple[float, float]:
    """Lowest and highest of the nodes' mean voltages over episodes without control, p.u."""
    split = WHOLE if scenario.split == WHOLE else "train"
    short = scenario.replace(source_voltage_pu=v_pu, split=split, horizon=min(scenario.horizon, LONGEST))
    recorder = rollout(short, NoControl(), range(episodes))
    each = [recorder.series(i).v_pu[1:, scenario.feeder.load_slice].mean(axis=0) for i in range(episodes)]
    mean = np.mean(each, axis=0)
    return float(mean.min()), float(mean.max())
