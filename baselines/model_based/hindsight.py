"""The least cost of a whole episode that is known beforehand, and the lower bound of the linear program behind it.

The program of ``episode_program`` is solved again around its own solution until the environment, in which its actions
are replayed, agrees. The replay's J is the hindsight cost; the program's own optimum stands beside it as the bound. It
is a bound on the grid linearised around the last trajectory: against the exact one it may be off by the curvature
between that trajectory and a better one, a few 1e-5 of J where that was looked for.

Where regulators follow a control of their own, taps change as what is done makes them, which no linear program says. So
programs are solved around several courses of taps, those under steady shares of reactive power, with rows that make the
relays change the taps at these steps and at no other; the best replay is taken. Where regulators or capacitor banks are
agents, ``equipment_program`` plans their positions too. Storages are planned by ``storage_rows``, and not beside such
equipment.
"""

from __future__ import annotations

from typing import Any, NamedTuple

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
from dcgrid_env.baselines.controller import KNOWN_DEVICES, require_draws_of_work, require_known_devices
from dcgrid_env.baselines.model_based.episode_program import EpisodeProgram
from dcgrid_env.baselines.model_based.equipment_program import CHANNELS, EquipmentProgram
from dcgrid_env.baselines.model_based.storage_rows import storages_of

STEADY_SHARES = (0.0, 0.5, -0.5, 1.0, -1.0)
"""Shares of the reactive power that there is, under which regulators take the courses of taps that are tried."""
HOPELESS = 0.01
"""Share of J by which the first program of a course is worse than the best replay where it is given up."""
SHORTER = (0.5, 0.25, 0.1, 0.03)
"""Shares of the way to a solution that are tried too where there are storages or work is routed."""
ROUNDS_SHORTENED = 14
"""Linear programs for an episode at most where there are storages: J settles early there, the bound later."""
GAP_SHORTENED = 7e-5
"""Gap between replay and program at which such an episode has settled, as a share of J."""
ROUNDS_ROUTED = 6
"""Linear programs for an episode at most where work is routed: J hardly changes from there on, the bound slowly."""
GAP_ROUTED = 3e-4
"""Gap between replay and program at which such an episode has settled, as a share of J."""
ROUNDS = 6
"""Linear programs for an episode at most."""
TOLERANCE = 2e-5
"""Gap between replay and program, or change of J between programs, at which an episode has settled, as a share of J."""
RELAXED = 1e-2
"""Change of the relaxation's optimum between programs at which it has settled, as a share of it; the next change would
be some hundredth of that."""
_ROUGHLY = 1e-3  # of its optimum, to which the first relaxation is solved, around positions at rest


class Effort(NamedTuple):
    """How far the episodes of a scenario are solved."""

    rounds: int
    """Linear programs for an episode at most."""
    gap: float
    """Gap between replay and program at which it has settled, as a share of J."""


def effort_of(scenario: Scenario) -> Effort:
    """How far episodes of this scenario are solved unless something else is asked for."""
    if scenario.datacenters.routing is not None:
        return Effort(ROUNDS_ROUTED, GAP_ROUTED)
    return Effort(ROUNDS, TOLERANCE) if storages_of(scenario) is None else Effort(ROUNDS_SHORTENED, GAP_SHORTENED)


class Hindsight(NamedTuple):
    """The least cost of an episode whose course is known from the beginning."""

    J: float
    """Cost of the actions, replayed in the environment."""
    bound: float
    """Optimum of the last linear program, around a trajectory like theirs. Where regulators act by themselves it is
    that of one course of their taps, the price of relays that cannot follow it included, and no bound on what other
    courses cost; where they are agents it is of the program that is free to choose any position, whole or not."""
    actions: np.ndarray
    """(T, n_action) in [-1, 1], as ``gymnasium.make`` takes them."""
    rounds: int
    """Linear programs solved."""
    recorder: Recorder
    """The replay."""

    @property
    def gap(self) -> float:
        """How far the replay is from the program."""
        return self.J - self.bound


def hindsight(
    scenario: Scenario, seed: int, rounds: int | None = None, tolerance: float = TOLERANCE, *, keep_band: bool = False
) -> Hindsight:
    """Solve the first episode of a seed.

    Parameters
    ----------
    scenario
        With the linear clock law and the l1 voltage cost, without a price on clock movement, voltage steps or losses;
        one on switching only where all that is not fixed is an agent.
    seed
        The episode.
    rounds
        Linear programs to solve at most; None: those of :func:`effort_of`.
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
    scenario = scenario.member(seed)
    _check(scenario)
    if rounds is None:
        rounds = effort_of(scenario).rounds
    if _has_equipment_agents(scenario):
        return _planned(EquipmentProgram(scenario, forecast(scenario, seed), keep_band), seed, rounds, tolerance)
    program = EpisodeProgram(scenario, forecast(scenario, seed), keep_band, same_taps=True)
    if acting_relays(scenario) is None:
        return _settled(program, seed, rounds, tolerance)
    return _over_tap_courses(program, seed, rounds, tolerance)


def _over_tap_courses(program: EpisodeProgram, seed: int, rounds: int, tolerance: float) -> Hindsight:
    """Solve around each course that taps take under a steady share of reactive power; the least cost of all."""
    best: Hindsight | None = None
    courses, solved = set(), 0
    for share in STEADY_SHARES:
        program.begin(share)
        program.follow(replay(program.scenario, program.actions(), seed))
        course = program.taps.tobytes()
        if course in courses:
            continue
        courses.add(course)
        found = _settled(program, seed, rounds, tolerance, hopeless=best and best.J * (1.0 + HOPELESS))
        solved += found.rounds
        best = found if best is None else min(found, best, key=lambda one: one.J)
    assert best is not None
    return best._replace(rounds=solved)


def _planned(program: EquipmentProgram, seed: int, rounds: int, tolerance: float) -> Hindsight:
    """Solve the relaxation around its own solutions until its optimum settles, then with whole positions."""
    bounds: list[float] = []
    while len(bounds) < rounds:
        program.follow(replay(program.scenario, program.actions(), seed))
        bounds.append((program.solve() if bounds else program.solve(_ROUGHLY))[0])
        if len(bounds) > 1 and abs(bounds[-1] - bounds[-2]) <= RELAXED * abs(bounds[-1]):
            break
    program.round()
    found = _settled(program, seed, rounds, tolerance)
    return found._replace(bound=bounds[-1], rounds=len(bounds) + found.rounds)


def _settled(
    program: EpisodeProgram | EquipmentProgram, seed: int, rounds: int, tolerance: float, hopeless: float | None = None
) -> Hindsight:
    """Solve a program around its own solutions until the replay agrees with it, or its optimum is ``hopeless``."""
    scenario = program.scenario
    has_equipment = isinstance(scenario.feeder, ThreePhaseFeeder)
    if has_equipment:
        program.follow(replay(scenario, program.actions(), seed))
    shortens = isinstance(program, EpisodeProgram) and _shifts(program)
    best: Hindsight | None = None
    for done in range(1, rounds + 1):
        bound, actions = program.solve()
        recorder = replay(scenario, actions, seed)
        if isinstance(program, EpisodeProgram) and shortens and done > 1:
            actions, recorder = _shortened(program, seed, actions, recorder)
        if has_equipment and not program.has_own_taps:
            program.follow(recorder)
        cost = recorder.metrics()[0]["J"]
        replayed = Hindsight(cost, bound, actions, done, recorder)
        settled = best is not None and abs(cost - best.J) <= tolerance * abs(cost)
        if best is None or cost <= best.J:
            best = replayed
        elif program.has_own_taps:
            best = best._replace(rounds=done)
        else:  # a program around a better trajectory knows better
            best = best._replace(bound=bound, rounds=done)
        if shortens:  # an unchanged J says nothing there of the bound
            settled = abs(best.gap) <= max(tolerance, _gap(program)) * abs(best.J)
        if settled or abs(replayed.gap) <= tolerance * abs(cost) or (hopeless is not None and bound > hopeless):
            break
    assert best is not None
    return best


def _gap(program: Any) -> float:
    return GAP_SHORTENED if program.work_rows.routing is None else GAP_ROUTED


def _shifts(program: EpisodeProgram) -> bool:
    """Whether energy or work can go to another time or place, for little, so that steps are to be shortened."""
    return program.n_storages > 0 or program.work_rows.routing is not None


def _shortened(
    program: EpisodeProgram, seed: int, actions: np.ndarray, recorder: Recorder
) -> tuple[np.ndarray, Recorder]:
    """The actions that do best on the way to the last solution, and their replay; the next program is around them.

    Storages shift energy to where losses are least, and routes work, which solutions of the linear program overdo:
    around each the next does the opposite, for ever. This is the method of M. Frank and P. Wolfe, "An algorithm for
    quadratic programming" (1956), its line searched at a few places.
    """
    tried = [(recorder.metrics()[0]["J"], 1.0, actions, recorder)]
    for share in SHORTER:
        shorter = program.go(share)
        replayed = replay(program.scenario, shorter, seed)
        tried.append((replayed.metrics()[0]["J"], share, shorter, replayed))
    _, share, actions, recorder = min(tried, key=lambda one: one[0])
    program.go(share)
    return actions, recorder


def replay(scenario: Scenario, actions: np.ndarray, seed: int) -> Recorder:
    """Play actions (T, n_action) in the episode of a seed; stops early where the power flow has no solution."""
    scenario = scenario.member(seed)
    env = DcgridVectorEnv(1, scenario if scenario.cost.reward == "shared" else scenario.replace(reward="shared"))
    env.reset(seed=[seed])
    recorder = Recorder(scenario, env.transition)
    for action in actions:
        env.step(action[None].astype(np.float32))
        recorder.add(env.transition)
        if recorder.over:
            break
    env.close()
    return recorder


def _has_equipment_agents(scenario: Scenario) -> bool:
    """Whether regulators or capacitor banks are agents, and nothing else but data centres first and inverters then."""
    kinds = [device.kind for device in scenario.devices if device.count]
    there = [kind for kind in (*KNOWN_DEVICES, *CHANNELS) if kind in kinds]
    return kinds == there and any(kind in CHANNELS for kind in kinds)


def _check(scenario: Scenario) -> None:
    planned = _has_equipment_agents(scenario)
    if not planned:
        require_known_devices("hindsight", scenario, further=("storage",))
    require_draws_of_work("hindsight", scenario)
    if any(getattr(device, "ride_through", None) is not None for device in scenario.devices):
        raise ValueError(
            f"hindsight plans no trips, which no linear program has; scenario {scenario.name!r} has ride_through: "
            "compare with the best that is known, or leave ride_through out"
        )
    sites: Any = scenario.datacenters
    if sites.batching is not None:
        raise ValueError(
            f"hindsight plans no batch sizes, whose energy is no linear function; scenario {scenario.name!r} has "
            "batching: leave it out, or compare with the best that is known"
        )
    if planned and (sites.routing is not None or sites.service is not None):
        raise ValueError("hindsight plans routing and service levels beside fixed or controlled equipment alone")
    if sites.routing is not None and sites.boost_share > 1.0:
        raise ValueError(
            "hindsight plans routing for sites that stay within their rating; set datacenters.boost_share to 1"
        )
    if any(getattr(device, "storage", None) is not None for device in scenario.devices):
        raise ValueError(
            f"hindsight plans storages that are agents; scenario {scenario.name!r} has them behind its data centres: "
            "give Storages at their buses instead, or leave datacenters.storage out"
        )
    if not isinstance(scenario.datacenters.clock_law, LinearDvfs):
        raise ValueError(
            f"hindsight knows the linear clock law only, not {type(scenario.datacenters.clock_law).__name__}"
        )
    if scenario.cost.voltage != "l1":
        raise ValueError(f"hindsight minimises the l1 voltage cost only, not {scenario.cost.voltage!r}")
    weights, alone = scenario.cost.weights, planned and not _acts_by_itself(scenario)
    priced = [name for name in weights.unmodelled if not (name == "switching" and alone)]
    if priced == ["switching"] and planned:
        raise ValueError(
            "hindsight prices the moves of agents alone; make all equipment that is controlled fixed or agents, or set "
            "the weight of switching to 0"
        )
    if priced:
        raise ValueError(f"hindsight does not price {priced[0]}; set its weight to 0, {CostWeights()!r}")


def _acts_by_itself(scenario: Scenario) -> bool:
    """Whether any regulator or capacitor bank follows a control of its own."""
    capacitors = scenario.grid_control.capacitors
    deciders = (capacitors,) if isinstance(capacitors, str) else dict(capacitors).values()
    return acting_relays(scenario) is not None or "controlled" in deciders
