"""A batch of environments of one scenario: it draws episodes, steps the physics and charges the cost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dcgrid_env.core.arrays import all_true
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.engine.cost import difference, observation, reward
from dcgrid_env.engine.cost.measurement import measure, measurement_noise, remembered
from dcgrid_env.engine.cost.tap_credit import TapTargets
from dcgrid_env.engine.exogenous import episode, trace_pool
from dcgrid_env.engine.exogenous.episode import EpisodeOptions
from dcgrid_env.engine.physics import dynamics
from dcgrid_env.engine.physics.acting_relays import acting_relays
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.engine.physics.state import Exogenous, GridStep, State, VoltageFigures
from dcgrid_env.engine.physics.voltage_figures import voltage_figures
from dcgrid_env.engine.snapshot import Snapshot, Transition, put_in
from dcgrid_env.scenario.scenario import Scenario

__all__ = ["Simulation", "Snapshot", "Transition"]


class Simulation:
    """Environments of one scenario, each in its own episode.

    Nothing is written in place: every step makes new arrays, so a snapshot is a tuple of references.
    """

    def __init__(self, scenario: Scenario, n_env: int):
        self.scenario = scenario
        self.n_env = n_env
        trace_pool.check_traces(scenario)
        self._now: Snapshot | None = None

    @property
    def now(self) -> Snapshot:
        """The current snapshot; RuntimeError before the first reset."""
        if self._now is None:
            raise RuntimeError("the environment has not been reset; call reset() first")
        return self._now

    @property
    def transition(self) -> Transition:
        """What the last step or reset led to."""
        return self.now.transition

    @property
    def has_begun(self) -> bool:
        """Whether there has been a reset."""
        return self._now is not None

    def restore(self, snapshot: Snapshot) -> None:
        """Go on from ``snapshot``; ValueError unless it is one of this scenario with as many environments."""
        if not isinstance(snapshot, Snapshot):
            raise ValueError(f"restore takes what save() gave, not a {type(snapshot).__name__}")
        other = snapshot.scenario.difference(self.scenario)
        if other is not None:
            raise ValueError(f"the snapshot is of a scenario with another {other}; restore it where it was saved")
        if len(snapshot.seeds) != self.n_env:
            raise ValueError(f"the snapshot has {len(snapshot.seeds)} environments, this one {self.n_env}")
        episode.prepare(self.scenario, snapshot.episode)
        self.go_on(snapshot)

    def scenario_of(self, env_index: int) -> Scenario:
        """The scenario on the feeder that an environment's episode is on; RuntimeError before the first reset."""
        return self.scenario

    def go_on(self, snapshot: Snapshot) -> None:
        """``restore`` of what is known to fit."""
        self._now = snapshot

    def reset(
        self, seeds: Sequence[int | None], mask: np.ndarray | None = None, options: EpisodeOptions | None = None
    ) -> Transition:
        """Begin a new episode in every environment, or where ``mask`` is True.

        An environment with a seed begins that seed's first episode; with None it begins its next one since it was
        last seeded. The arrays of ``options`` have a row for each environment that begins.
        """
        env_indices = np.arange(self.n_env) if mask is None else np.flatnonzero(mask)
        drawn = self._begin(env_indices, seeds, options)
        self._now = drawn if len(env_indices) == self.n_env else self._merged(self.now, drawn, env_indices)
        return self._now.transition

    def step_or_begin(self, action: np.ndarray) -> Transition:
        """Advance the environments whose episode goes on; the others begin their next one, whatever their action."""
        env_indices = np.flatnonzero(self.now.over)
        initial = self._begin(env_indices, [None] * self.n_env)
        if len(env_indices) == self.n_env:
            self._now = initial
            return initial.transition
        # The physics steps all environments at once: those that begin stay in the batch, and are then put back.
        self._now = self._merged(self.now, initial, env_indices)
        self.step(action)
        self._now = self._merged(self.now, initial, env_indices)
        return self._now.transition

    def step(self, action: np.ndarray) -> Transition:
        """Advance every environment by one step of joint actions (row, n_action) in [-1, 1]."""
        now = self.now
        step = now.step + 1
        outside = episode.exogenous(self.scenario, now.episode, step, now.noise, now.p_ref_next_kw)
        p_ref_next = episode.p_ref_kw(self.scenario, now.episode, step + 1)
        state, grid = dynamics.step(self.scenario, now.state, action, outside)
        measured = (*now.measured[1:], self._measure(now.episode, step, state))
        j_before = now.transition.j_so_far
        transition = self._transition(now.episode, step, state, grid, measured, p_ref_next, j_before)
        if self.scenario.cost.reward == "difference":
            vector = self._saved(now.state, state, action, outside) / difference_scale(self.scenario.family)
            if not all_true(solved := transition.converged):
                vector = np.where(solved[:, None], vector, -transition.cost_j[:, None])
            paid = difference.sums_by_agent(self.scenario, vector)
            transition = transition._replace(reward=paid, reward_vector=vector)
        same = self.scenario, now.seeds, now.numbers, now.episode
        self._now = Snapshot(*same, step, grid.noise, p_ref_next, state, measured, transition)
        return transition

    def _begin(
        self, env_indices: np.ndarray, seeds: Sequence[int | None], options: EpisodeOptions | None = None
    ) -> Snapshot:
        """New episodes of these environments, see ``reset``."""
        seed = np.zeros(len(env_indices), np.uint64)
        number = np.zeros(len(env_indices), np.uint64)
        for i, env_index in enumerate(env_indices):
            given_seed = seeds[env_index]
            if given_seed is not None:
                seed[i] = int(given_seed) % 2**64
            else:
                seed[i], number[i] = self.now.seeds[env_index], self.now.numbers[env_index] + np.uint64(1)
        return self._drawn(seed, number, options)

    def _drawn(self, seed: np.ndarray, number: np.ndarray, options: EpisodeOptions | None = None) -> Snapshot:
        """Episodes at their beginning, of seeds and numbers of episodes since these, (row,) uint64 each."""
        drawn = episode.draw(self.scenario, seed, number, options)
        step = np.zeros(len(seed), np.int64)
        quiet = np.zeros((len(seed), self.scenario.feeder.n_bus))
        p_ref, p_ref_next = (episode.p_ref_kw(self.scenario, drawn, step + ahead) for ahead in (0, 1))
        outside = episode.exogenous(self.scenario, drawn, step, quiet, p_ref)
        state, grid = dynamics.initial_state(self.scenario, outside)
        measured = (self._measure(drawn, step, state),) * remembered(self.scenario)
        zeros = np.zeros(len(seed))
        transition = self._transition(drawn, step, state, grid, measured, p_ref_next, zeros)
        free = transition.costs._make(0.0 * term for term in transition.costs)  # t = 0 is not charged
        paid, vector = np.zeros_like(transition.reward), None
        if self.scenario.cost.reward == "difference":
            paid, vector = (np.zeros((len(seed), n)) for n in (self.scenario.n_agents, action_layout(self.scenario).n))
        transition = transition._replace(costs=free, cost_j=zeros, j_so_far=zeros, reward=paid, reward_vector=vector)
        return Snapshot(self.scenario, seed, number, drawn, step, grid.noise, p_ref_next, state, measured, transition)

    def _merged(self, now: Snapshot, drawn: Snapshot, env_indices: np.ndarray) -> Snapshot:
        """``now`` with the environments of ``drawn`` put in."""
        return put_in(self.scenario, now, drawn, env_indices)

    def _saved(self, before: State, after: State, action: np.ndarray, outside: Exogenous) -> np.ndarray:
        """Return the cost that each entry of a joint action has saved in a step, (row, n_action)."""
        default = difference.default_setpoints(self.scenario, before, outside.p_ref_kw)
        setpoints = dynamics.setpoints_of(self.scenario, action)
        targets, steps_left = tap_targets(self.scenario), self.scenario.horizon - self.now.step - 1
        arguments = (self.scenario, before, after, setpoints, default, outside, self.now.episode.buses)
        return difference.differences(*arguments, targets, steps_left)

    def _measure(self, drawn: episode.Episode, step: np.ndarray, state: State) -> np.ndarray:
        return measure(self.scenario, state, measurement_noise(self.scenario, drawn.key, step))

    def _transition(
        self,
        drawn: episode.Episode,
        step: np.ndarray,
        state: State,
        grid: GridStep,
        measured: tuple[np.ndarray, ...],
        p_ref_next: np.ndarray,
        j_before: np.ndarray,
    ) -> Transition:
        s, solution = self.scenario, grid.solution
        last = step >= s.horizon
        solved = all_true(solution.converged)
        figures = grid.figures if solved and grid.figures else _figures(s, state)
        costs = reward.team_costs(s, state, solution, last, figures)
        costs = costs if solved else reward.charged(s, costs, step, solution.converged)
        cost_j = reward.total(costs)
        next_input = episode.given_next(s, drawn, step, p_ref_next)
        observed = observation.observe_within_bounds(s, state, drawn.placed, next_input, measured[1], measured[0])
        if s.cost.reward != "local":
            paid = -cost_j
        else:
            local_costs = reward.local_costs(s, state, solution, last, drawn.placed.nodes)
            paid = -reward.total(reward.charged(s, local_costs, step, solution.converged))
        return Transition(
            observation=observed,
            reward=paid,
            terminated=np.zeros(len(last), np.bool_) if solved else ~solution.converged & (step > 0),
            truncated=last if solved else solution.converged & last,
            costs=costs,
            voltages=figures,
            cost_j=cost_j,
            j_so_far=j_before + cost_j / s.horizon,
            state=state,
            loss_kw=solution.loss_kw,
            converged=solution.converged,
            trace_start=drawn.start,
            buses=drawn.buses,
            fault=drawn.fault,
        )


def _figures(scenario: Scenario, state: State) -> VoltageFigures:
    v_pu = np.ascontiguousarray(state.v_pu, np.float64)
    return voltage_figures(v_pu, scenario.feeder.load_slice.start, scenario.cost.band_pu)


SCALE_EPISODES, SCALE_STEPS = 16, 8
"""Episodes, and steps in each, that ``difference_scale`` is measured in."""


@cached_on_owner
def difference_scale(scenario: Scenario) -> np.ndarray:
    """Return the divisor of the cost that each entry of the joint action saves, (n_action,), the same for a channel.

    One set point is moved to either end of its range, in the first training episodes and without other control. The
    divisor is the mean over all agents with the channel of the larger change in cost, or 1 if the channel has no
    effect. The violation is not counted, because a trained policy has little. A positive divisor does not change which
    action of a channel is best. On random feeders it is measured on the first training feeder.
    """
    layout = action_layout(scenario)
    training = scenario.paid_as_team().replace(split="train", weights={"violation": 0.0})
    sampled = Simulation(training.member(0), SCALE_EPISODES)
    sampled.reset(range(SCALE_EPISODES))
    s, largest = sampled.scenario, []
    rest = np.tile(difference.rest_action(s), (SCALE_EPISODES, 1))
    ends = (np.full_like(rest, -1.0), rest, np.ones_like(rest))
    lowest, resting, highest = (dynamics.setpoints_of(s, action) for action in ends)
    for _ in range(min(SCALE_STEPS, s.horizon)):
        now = sampled.now
        outside = episode.exogenous(s, now.episode, now.step + 1, now.noise, now.p_ref_next_kw)
        after = sampled.step(rest).state
        moved = [
            difference.differences(s, now.state, after, resting, end, outside, now.episode.buses)
            for end in (lowest, highest)
        ]
        largest.append(np.maximum(*np.abs(moved)))
    scale = np.ones(layout.n)
    for name in dict.fromkeys(name for _, name in layout.names):
        of_channel = layout.is_channel(name)
        scale[of_channel] = np.concatenate(largest)[:, of_channel].mean() or 1.0
    return scale


TAP_EPISODES = 8
"""Episodes that ``tap_targets`` are found in."""


@cached_on_owner
def tap_targets(scenario: Scenario) -> TapTargets | None:
    """Return the useful taps of the regulators whose relays act, in the first training episodes; None without any.

    The search is for costs that ``difference.has_kernel`` accepts; with others there are none.
    """
    relays = acting_relays(scenario)
    if relays is None or not difference.has_kernel(scenario):
        return None
    from dcgrid_env.engine.cost.tap_targets import useful_taps  # for scenarios with such relays alone

    sampled = Simulation(scenario.replace(split="train"), TAP_EPISODES)
    initial = sampled.reset(range(TAP_EPISODES))
    return useful_taps(sampled.scenario, relays, initial.state, initial.buses)
