"""The least cost of a whole episode that is known beforehand, and the lower bound of the linear program behind it.

The program of ``episode_program`` is solved again around its own solution until the environment, in which its actions
are replayed, agrees. The replay's J is the hindsight cost; the program's own optimum stands beside it as the bound. It
is a bound on the grid linearised around the last trajectory: against the exact one it may be off by the curvature
between that trajectory and a better one, a few 1e-5 of J where that was looked for.

Where regulators follow a control of their own, two programs are solved and the better replay is taken: one around the
taps of the replay before, and one that keeps each relay from moving its tap at all, by a step in band before its delay
is over.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env import (
    CostWeights,
    DcgridVectorEnv,
    LinearDvfs,
    Recorder,
    Scenario,
    ThreePhaseFeeder,
    acting_relays,
    forecast,
)
from dcgrid_env.baselines.controller import require_known_devices
from dcgrid_env.baselines.model_based.episode_program import EpisodeProgram
from dcgrid_env.baselines.model_based.linear_model import NOT_PRICED

ROUNDS = 6
"""Linear programs for an episode at most."""
TOLERANCE = 2e-5
"""Gap between replay and program, or change of J between programs, at which an episode has settled, as a share of J."""


class Hindsight(NamedTuple):
    """The least cost of an episode whose course is known from the beginning."""

    J: float
    """Cost of the actions, replayed in the environment."""
    bound: float
    """Optimum of the last linear program, around a trajectory like theirs. Where regulators or capacitor banks act it
    takes their taps and switches as they were in the replay before, and so is no bound on what else they might do."""
    actions: np.ndarray
    """(T, n_action) in [-1, 1], as ``gymnasium.make`` takes them."""
    rounds: int
    """Linear programs solved, of both kinds."""
    recorder: Recorder
    """The replay."""

    @property
    def gap(self) -> float:
        """How far the replay is from the program."""
        return self.J - self.bound


def hindsight(
    scenario: Scenario, seed: int, rounds: int = ROUNDS, tolerance: float = TOLERANCE, *, keep_band: bool = False
) -> Hindsight:
    """Solve the first episode of a seed.

    Parameters
    ----------
    scenario
        With the linear clock law and the l1 voltage cost, without a price on clock movement, voltage steps or losses.
    seed
        The episode.
    rounds
        Linear programs to solve at most.
    tolerance
        Gap between replay and program, or change of J between programs, at which to stop, as a share of J.
    keep_band
        Whether every voltage of the program must stay within the band, whatever it costs.

    Raises
    ------
    ValueError
        For a scenario with other costs or another clock law, naming them, or a program without a solution, naming
        the constraint that cannot be met, where and when.
    """
    _check(scenario)
    best = _settled(EpisodeProgram(scenario, forecast(scenario, seed), keep_band), seed, rounds, tolerance)
    if acting_relays(scenario) is not None:
        program = EpisodeProgram(scenario, forecast(scenario, seed), keep_band, keep_taps=True)
        kept = _settled(program, seed, rounds, tolerance)
        best = min(kept, best, key=lambda found: found.J)._replace(rounds=kept.rounds + best.rounds)
    return best


def _settled(program: EpisodeProgram, seed: int, rounds: int, tolerance: float) -> Hindsight:
    """Solve a program around its own solutions until the replay agrees with it."""
    scenario = program.scenario
    has_equipment = isinstance(scenario.feeder, ThreePhaseFeeder)
    if has_equipment:
        program.follow(replay(scenario, program.actions(), seed))
    best: Hindsight | None = None
    for done in range(1, rounds + 1):
        bound, actions = program.solve()
        recorder = replay(scenario, actions, seed)
        if has_equipment:
            program.follow(recorder)
        cost = recorder.metrics()[0]["J"]
        replayed = Hindsight(cost, bound, actions, done, recorder)
        settled = best is not None and abs(cost - best.J) <= tolerance * abs(cost)
        # A program around a better trajectory knows better, so the last one's optimum is the bound.
        best = replayed if best is None or cost <= best.J else best._replace(bound=bound, rounds=done)
        if settled or abs(replayed.gap) <= tolerance * abs(cost):
            break
    assert best is not None
    return best


def replay(scenario: Scenario, actions: np.ndarray, seed: int) -> Recorder:
    """Play actions (T, n_action) in the episode of a seed; stops early where the power flow has no solution."""
    env = DcgridVectorEnv(1, scenario.replace(reward="shared"))
    env.reset(seed=[seed])
    recorder = Recorder(scenario, env.transition)
    for action in actions:
        env.step(action[None].astype(np.float32))
        recorder.add(env.transition)
        if recorder.over:
            break
    env.close()
    return recorder


def _check(scenario: Scenario) -> None:
    require_known_devices("hindsight", scenario)
    if not isinstance(scenario.dvfs, LinearDvfs):
        raise ValueError(f"hindsight knows the linear clock law only, not {type(scenario.dvfs).__name__}")
    if scenario.voltage_cost != "l1":
        raise ValueError(f"hindsight minimises the l1 voltage cost only, not {scenario.voltage_cost!r}")
    priced = [name for name in NOT_PRICED if getattr(scenario.weights, name)]
    if priced:
        raise ValueError(f"hindsight does not price {priced[0]}; set its weight to 0, {CostWeights()!r}")
