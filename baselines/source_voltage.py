"""Choose a substation voltage for a scenario on a feeder without a suitable one, so that voltages are centred.

Most published feeders specify 1 p.u., at which all their voltages are below 1 p.u. A learner would then be rewarded for
compensating a badly chosen tap. The rule sets the source as a tap changer would: the mean voltages of the buses over
episodes without control extend as far above 1 p.u. as below it. If automatic regulators act on the feeder, they control
its voltages, and the source is left unchanged. The effect of the rule on costs is described in docs/own-feeder.md.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env import Scenario, acting_relays
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.baselines.rollout import rollout

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
    is_own: bool
    """Whether it is the scenario's value, which was kept because regulators act."""


def centred_voltage(scenario: Scenario, episodes: int = EPISODES) -> SourceVoltage:
    """Find the substation voltage, on whole taps and within the scenario's band, that centres the mean voltages.

    Parameters
    ----------
    scenario
        Any scenario; the episodes are of its training split.
    episodes
        How many, of seeds 0, 1, ..
    """
    if acting_relays(scenario) is not None:
        return SourceVoltage(scenario.source_voltage_pu, *_reach(scenario, scenario.source_voltage_pu, episodes), True)
    taps = int(scenario.cost.band_pu / TAP_PU + 1e-9)
    tap, tried = taps, dict[int, tuple[float, float]]()  # from the top, where a power flow has most room
    for _ in range(_ROUNDS):
        tried[tap] = lowest, highest = _reach(scenario, 1.0 + tap * TAP_PU, episodes)
        nearer = int(np.clip(tap + round((1.0 - 0.5 * (lowest + highest)) / TAP_PU), -taps, taps))
        if nearer in tried:
            break
        tap = nearer
    best = min(tried, key=lambda tap: abs(sum(tried[tap]) - 2.0))
    return SourceVoltage(1.0 + best * TAP_PU, *tried[best], False)


def _reach(scenario: Scenario, v_pu: float, episodes: int) -> tuple[float, float]:
    """Lowest and highest of the nodes' mean voltages over episodes without control, p.u."""
    short = scenario.replace(source_voltage_pu=v_pu, split="train", horizon=min(scenario.horizon, LONGEST))
    recorder = rollout(short, NoControl(), range(episodes))
    each = [recorder.series(i).v_pu[1:, scenario.feeder.load_slice].mean(axis=0) for i in range(episodes)]
    mean = np.mean(each, axis=0)
    return float(mean.min()), float(mean.max())
