"""Compute the least cost of an episode with perfect foresight, and the optimum of the linear program behind it.

The program of ``episode_program`` is solved repeatedly around its previous solution until the environment, in which its
actions are replayed, agrees. The J of the replay is the hindsight cost. The optimum of the program is reported as the
bound. It is a lower bound on the grid linearised around the last trajectory. On the exact grid it may be off by the
curvature between that trajectory and a better one: a few 1e-5 of J in the cases that were checked.

Automatic regulators change their taps in response to the actions, which a linear program cannot express. Programs are
therefore solved around given tap trajectories. Additional rows make the relays change the taps at these steps and at no
other, and the best replay is the result. ``tap_search`` finds the trajectories, from those without control and under
MPC on. ``tap_bound`` finds a lower bound over all trajectories.

If regulators or capacitor banks are agents, ``equipment_program`` plans their positions too. If agents choose their set
points, the replay has the positions to which the set points lead. ``storage_rows`` plans storages, which cannot be
combined with such equipment.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

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
from dcgrid_env.baselines.controller import KNOWN_DEVICES, require_known_devices, require_work_draws
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.baselines.model_based.episode_program import EpisodeProgram
from dcgrid_env.baselines.model_based.equipment_program import CHANNELS, SETTERS, EquipmentProgram
from dcgrid_env.baselines.model_based.mpc import Mpc
from dcgrid_env.baselines.model_based.storage_rows import storages_of
from dcgrid_env.baselines.model_based.tap_bound import tap_bound
from dcgrid_env.baselines.model_based.tap_search import TapSearch
from dcgrid_env.baselines.model_based.tap_trajectory import TapTrajectory
from dcgrid_env.baselines.model_based.trajectory import HindsightError
from dcgrid_env.baselines.rollout import ControllerError, rollout
from dcgrid_env.devices import may_leave

STARTS = (NoControl, Mpc)
"""Controllers around whose tap trajectories better ones are searched."""
ROUNDS_SEARCHED = 15
"""Maximum number of linear programs around the tap trajectories that are found from a start."""
FOLLOWED = 3
"""Maximum number of linear programs around one tap trajectory."""
GAP_FOLLOWED = 3e-4
"""Gap between replay and program at which a tap trajectory has been followed, as a share of J."""
SEARCHED = 1e-4
"""Change of J from one tap trajectory to the next at which the search has settled, as a share of it."""
GAP_BEST_KNOWN = 1e-3
"""Gap to the bound, as a share of J, above which a cost that was searched is called the best known."""
SHORTER = (0.5, 0.25, 0.1, 0.03)
"""Shorter steps towards a solution, as shares, that are also tried with storages or routing of work."""
ROUNDS_SHORTENED = 14
"""Maximum number of linear programs for an episode with storages: J settles early there, the bound later."""
GAP_SHORTENED = 7e-5
"""Gap between replay and program at which an episode with storages has settled, as a share of J."""
ROUNDS_ROUTED = 6
"""Maximum number of linear programs for an episode with routed work: later, J hardly changes and the bound slowly."""
GAP_ROUTED = 3e-4
"""Gap between replay and program at which an episode with routed work has settled, as a share of J."""
ROUNDS = 6
"""Maximum number of linear programs for any other episode."""
TOLERANCE = 2e-5
"""Gap between replay and program, or change of J between programs, at which an episode has settled, as a share of J."""
RELAXED = 1e-2
"""Change of the relaxation's optimum between programs at which it has settled, as a share of it; the next change would
be some hundredth of that."""
_ROUGHLY = 1e-3  # of its optimum, to which the first relaxation is solved, around positions at rest


class Effort(NamedTuple):
    """Stopping criteria for the episodes of a scenario."""

    rounds: int
    """Maximum number of linear programs for an episode."""
    gap: float
    """Gap between replay and program at which it has settled, as a share of J."""


def effort_of(scenario: Scenario) -> Effort:
    """Return the default stopping criteria for episodes of a scenario."""
    if scenario.datacenters.routing is not None:
        return Effort(ROUNDS_ROUTED, GAP_ROUTED)
    if searches_taps(scenario):
        return Effort(ROUNDS_SEARCHED, GAP_BEST_KNOWN)
    if _has_equipment_agents(scenario):
        return Effort(ROUNDS, GAP_BEST_KNOWN)
    return Effort(ROUNDS, TOLERANCE) if storages_of(scenario) is None else Effort(ROUNDS_SHORTENED, GAP_SHORTENED)


class Hindsight(NamedTuple):
    """The least cost of an episode that is known from the beginning."""

    J: float
    """Cost of the actions, replayed in the environment."""
    bound: float
    """Optimum of the last linear program, around a trajectory close to that of the actions. If regulators are agents,
    or have controls that act, it is the optimum over continuous taps."""
    actions: np.ndarray
    """(T, n_action) in [-1, 1], as ``gymnasium.make`` takes them."""
    rounds: int
    """Linear programs solved."""
    recorder: Recorder
    """The replay."""

    @property
    def gap(self) -> float:
        """Difference in cost between the replay and the program."""
        return self.J - self.bound


def hindsight(
    scenario: Scenario, seed: int, rounds: int | None = None, tolerance: float = TOLERANCE, *, keep_band: bool = False
) -> Hindsight:
    """Solve the first episode of a seed.

    Parameters
    ----------
    scenario
        Scenario with the linear clock law and the l1 voltage cost, without a price on clock movement, voltage steps or
        losses. A price on switching is allowed if all equipment that is not fixed is an agent, or if it is regulators
        under their built-in controls.
    seed
        The episode.
    rounds
        Maximum number of linear programs, around each tap trajectory where there are several to begin with; None for
        that of :func:`effort_of`.
    tolerance
        Gap between replay and program, or change of J between programs, at which to stop, as a share of J. Not for
        regulators whose controls act.
    keep_band
        Whether every voltage of the program must stay within the band at any cost.

    Raises
    ------
    ValueError
        If the scenario has other costs or another clock law, or if the program has no solution. The message names the
        cost or law, or the constraint that cannot be met, where and when.
    """
    scenario = scenario.member(seed)
    _check(scenario)
    if rounds is None:
        rounds = effort_of(scenario).rounds
    if _has_equipment_agents(scenario):
        return _planned(EquipmentProgram(scenario, forecast(scenario, seed), keep_band), seed, rounds, tolerance)
    searches = searches_taps(scenario)
    program = EpisodeProgram(scenario, forecast(scenario, seed), keep_band, leads_relays=searches)
    return _over_searched_taps(program, seed, rounds) if searches else _settled(program, seed, rounds, tolerance)


def searches_taps(scenario: Scenario) -> bool:
    """Return whether hindsight searches tap trajectories: built-in controls of regulators act, and none is an agent."""
    return acting_relays(scenario) is not None and not _has_equipment_agents(scenario)


def finds_best_known(scenario: Scenario) -> bool:
    """Return whether hindsight searches or rounds the positions of equipment, so a lower cost may exist."""
    return searches_taps(scenario) or _has_equipment_agents(scenario)


def _over_searched_taps(program: EpisodeProgram, seed: int, rounds: int) -> Hindsight:
    """Search tap trajectories around those of the controllers of ``STARTS``; return the least cost."""
    scenario, results = program.scenario, []
    for controller in STARTS:
        try:
            start = rollout(scenario.replace(observe="feeder"), controller(), [seed])
        except ControllerError as error:
            if error.refuses is None:
                raise
            continue
        results.append(_searched(program, start, seed, rounds))
    best = min(results, key=lambda one: one.J)
    bound = tap_bound(scenario, program.episode, best.recorder)
    return best._replace(bound=bound, rounds=sum(one.rounds for one in results))


def _searched(program: EpisodeProgram, start: Recorder, seed: int, rounds: int) -> Hindsight:
    """Search tap trajectories around that of a replay, and lead the relays along each, until J settles."""
    assert program.relays is not None
    program.follow(start)
    program.retrace(start)
    search, trajectory = TapSearch(program), TapTrajectory.of_taps(program.taps[:, program.relays.rows])
    best = _replayed(program, -np.inf, program.actions(), 0, seed)
    done = 0
    while done < rounds:
        search.around()
        trajectory, _ = search.improved(trajectory)
        before = best.J
        for _ in range(min(FOLLOWED, rounds - done)):
            program.lead(trajectory)
            done += 1
            replayed = _replayed(program, *program.solve(), done, seed)
            best = min(best, replayed, key=lambda one: one.J)
            tap = replayed.recorder.series(0).three_phase.equipment.regulators.tap
            if np.array_equal(tap, program.taps) and abs(replayed.gap) <= GAP_FOLLOWED * replayed.J:
                break
        if before - best.J <= SEARCHED * best.J:
            break
    return best._replace(rounds=done)


def _replayed(program: EpisodeProgram, bound: float, actions: np.ndarray, rounds: int, seed: int) -> Hindsight:
    recorder = replay(program.scenario, actions, seed)
    return Hindsight(recorder.metrics()[0]["J"], bound, actions, rounds, recorder)


def _planned(program: EquipmentProgram, seed: int, rounds: int, tolerance: float) -> Hindsight:
    """Solve the relaxation repeatedly until its optimum settles, then solve with whole positions."""
    bounds: list[float] = []
    while len(bounds) < rounds:
        program.follow(replay(program.scenario, program.actions(), seed))
        bounds.append((program.solve() if bounds else program.solve(_ROUGHLY))[0])
        if len(bounds) > 1 and abs(bounds[-1] - bounds[-2]) <= RELAXED * abs(bounds[-1]):
            break
    program.round()
    settled = _settled(program, seed, rounds, tolerance)
    return settled._replace(bound=bounds[-1], rounds=len(bounds) + settled.rounds)


def _settled(program: EpisodeProgram | EquipmentProgram, seed: int, rounds: int, tolerance: float) -> Hindsight:
    """Solve a program around its solutions until the replay agrees with it."""
    scenario = program.scenario
    has_equipment = isinstance(scenario.feeder, ThreePhaseFeeder)
    if has_equipment and isinstance(program, EpisodeProgram):  # positions that were planned stay until the first replay
        program.follow(replay(scenario, program.actions(), seed))
    shortens = isinstance(program, EpisodeProgram) and _shifts(program)
    best: Hindsight | None = None
    for done in range(1, rounds + 1):
        bound, actions = program.solve()
        recorder = replay(scenario, actions, seed)
        if isinstance(program, EpisodeProgram) and shortens and done > 1:
            actions, recorder = _shortened(program, seed, actions, recorder)
        if has_equipment:
            program.follow(recorder)
        cost = recorder.metrics()[0]["J"]
        replayed = Hindsight(cost, bound, actions, done, recorder)
        settled = best is not None and abs(cost - best.J) <= tolerance * abs(cost)
        # The bound of a program around a better trajectory is more accurate.
        best = replayed if best is None or cost <= best.J else best._replace(bound=bound, rounds=done)
        if shortens:  # here an unchanged J does not mean that the bound has settled
            settled = abs(best.gap) <= max(tolerance, _gap(program)) * abs(best.J)
        if settled or abs(replayed.gap) <= tolerance * abs(cost):
            break
    assert best is not None
    return best


def _gap(program: Any) -> float:
    return GAP_SHORTENED if program.work_rows.routing is None else GAP_ROUTED


def _shifts(program: EpisodeProgram) -> bool:
    """Whether energy or work can move to another time or place at little cost, which requires shorter steps."""
    return program.n_storages > 0 or program.work_rows.routing is not None


def _shortened(
    program: EpisodeProgram, seed: int, actions: np.ndarray, recorder: Recorder
) -> tuple[np.ndarray, Recorder]:
    """Find the best actions on the way to the last solution, and their replay; the next program is around them.

    Storages shift energy to where losses are least, and routing shifts work. Solutions of the linear program overdo
    both: each new solution does the opposite of the last, and the iteration does not settle. This is the method of
    M. Frank and P. Wolfe, "An algorithm for quadratic programming" (1956), with a line search at a few points.
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
    """Play actions (T, n_action) in the episode of a seed; stop early if the power flow has no solution."""
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
    """Whether regulators or capacitor banks are agents, and all others are data centres, then inverters."""
    kinds = [device.kind for device in scenario.devices if device.count]
    equipment = (*CHANNELS, *SETTERS)
    there = [kind for kind in (*KNOWN_DEVICES, *equipment) if kind in kinds]
    return kinds == there and any(kind in equipment for kind in kinds)


def _check(scenario: Scenario) -> None:
    planned = _has_equipment_agents(scenario)
    try:
        if not planned:
            require_known_devices("hindsight", scenario, further=("storage",))
        require_work_draws("hindsight", scenario)
    except ValueError as error:
        raise HindsightError(str(error)) from None
    if any(map(may_leave, scenario.devices)):
        raise HindsightError(
            f"hindsight plans no trips, which no linear program has; scenario {scenario.name!r} has ride_through: "
            "compare with the best that is known, or leave ride_through out"
        )
    if scenario.grid_control.regulator_settings.has_schedules:
        raise HindsightError(
            f"hindsight plans taps under constant set points; scenario {scenario.name!r} has a schedule in "
            "grid_control.regulator_settings.offset_v: give it numbers"
        )
    sites = scenario.datacenters
    if sites.batching is not None:
        raise HindsightError(
            f"hindsight plans no batch sizes, whose energy is no linear function; scenario {scenario.name!r} has "
            "batching: leave it out, or compare with the best that is known"
        )
    if planned and (sites.routing is not None or sites.service is not None):
        raise HindsightError("hindsight plans routing and service levels beside fixed or controlled equipment alone")
    if sites.routing is not None and sites.boost_share > 1.0:
        raise HindsightError(
            "hindsight plans routing for sites that stay within their rating; set datacenters.boost_share to 1"
        )
    if any(getattr(device, "storage", None) is not None for device in scenario.devices):
        raise HindsightError(
            f"hindsight plans storages that are agents; scenario {scenario.name!r} has them behind its data centres: "
            "give Storages at their buses instead, or leave datacenters.storage out"
        )
    if not isinstance(scenario.datacenters.clock_law, LinearDvfs):
        raise HindsightError(
            f"hindsight knows the linear clock law only, not {type(scenario.datacenters.clock_law).__name__}"
        )
    if scenario.cost.voltage != "l1":
        raise HindsightError(f"hindsight minimises the l1 voltage cost only, not {scenario.cost.voltage!r}")
    weights, searches = scenario.cost.weights, searches_taps(scenario)
    others = _has_controlled_banks(scenario) or (planned and _has_controlled_regulators(scenario))
    priced = [name for name in weights.unmodelled if name != "switching" or others or not (planned or searches)]
    if not planned and "grid_request" in priced:
        priced.remove("grid_request")
    if priced == ["switching"] and (planned or searches):
        moves = "taps of built-in controls" if searches else "moves of agents"
        raise HindsightError(
            f"hindsight prices the {moves} alone; make all other equipment fixed, or set the weight of switching to 0"
        )
    if planned and (slow := _slow_regulators(scenario)):
        raise HindsightError(
            f"hindsight plans set points for steps in which a control finishes; in scenario {scenario.name!r} dt_s is "
            f"{scenario.dt_s:g} and the delay of {slow[0]} longer: give a longer dt_s"
        )
    if priced:
        raise HindsightError(f"hindsight does not price {priced[0]}; set its weight to 0, {CostWeights()!r}")


def _has_controlled_regulators(scenario: Scenario) -> bool:
    """Whether the built-in control of any regulator acts under set points that no agent chooses."""
    relays = acting_relays(scenario)
    return relays is not None and bool(set(relays.rows.tolist()) - _setter_rows(scenario))


def _slow_regulators(scenario: Scenario) -> list[str]:
    """Names of regulators whose set points agents choose and whose delay does not end within a step."""
    relays, feeder = acting_relays(scenario), cast(Any, scenario.feeder)
    if relays is None:
        return []
    rows = relays.rows[relays.steps > 1].tolist()
    chosen = _setter_rows(scenario)
    return [feeder.network.regulator.name[row] for row in rows if row in chosen]


def _setter_rows(scenario: Scenario) -> set[int]:
    """Rows of the regulators whose set points agents choose."""
    devices = cast(Any, scenario.devices)
    return {row for device in devices if device.kind == SETTERS[0] for rows in device.members for row in rows}


def _has_controlled_banks(scenario: Scenario) -> bool:
    """Whether any capacitor bank is controlled automatically."""
    capacitors = scenario.grid_control.capacitors
    return "controlled" in ((capacitors,) if isinstance(capacitors, str) else dict(capacitors).values())
