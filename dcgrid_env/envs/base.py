"""Shared base of the three interfaces: a simulation, its spaces, saving and restoring, rendering."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces

from dcgrid_env.engine.cost import observation
from dcgrid_env.engine.physics import actions
from dcgrid_env.envs.info import INFO_LEVELS, InfoLevel
from dcgrid_env.grid import bus_numbers
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.scenario.errors import ScenarioError, UnknownArgumentError
from dcgrid_env.scenario.presets import make_scenario
from dcgrid_env.scenario.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.engine.exogenous.episode import EpisodeOptions
    from dcgrid_env.engine.simulation import Simulation, Snapshot, Transition

HUGE = 1000
"""Number of nodes above which a warning is given that each agent observes every voltage."""


class HugeObservationWarning(UserWarning):
    """An observation or a global state holds the voltage of every node of a very large feeder."""


def warn_if_huge(scenario: Scenario, subject: str, remedy: str) -> None:
    """Warn that ``subject`` grows with the feeder if the feeder is very large."""
    n = len(scenario.feeder.load_nodes)
    if n > HUGE:
        warnings.warn(f"{subject} holds the voltages of {n:,} nodes; {remedy}", HugeObservationWarning, stacklevel=4)


class EpisodeCutWarning(UserWarning):
    """Episodes are reset before their end, each at the same step, as a time limit around the environment does."""


CUTS = 3
"""Number of successive episodes, reset at the same step before their end, after which a warning is given."""

RENDER_MODES = ("human", "rgb_array")


def joint_spaces(scenario: Scenario) -> tuple[spaces.Box, spaces.Box]:
    """Spaces of the joint observation and action."""
    low, high = observation.joint_bounds(scenario)
    layout = actions.action_layout(scenario)
    return spaces.Box(low, high, dtype=np.float32), spaces.Box(*layout.bounds, dtype=np.float32)


def joint_reward(transition: Transition) -> np.ndarray:
    """Return the reward of each environment as a new array, (row,): the sum over agents of difference rewards."""
    return transition.reward.copy() if transition.reward.ndim == 1 else transition.reward.sum(-1)


def check_running(env: BaseEnvironment) -> None:
    """Raise RuntimeError unless the episode of the (first) environment is running."""
    last = env._simulation.transition
    if last.truncated[0] or last.terminated[0]:
        raise RuntimeError("the episode is over; call reset()")


class BaseEnvironment:
    """Mixin of the environment classes, which contains one simulation."""

    scenario: Scenario
    render_mode: str | None
    info_level: InfoLevel
    pays_team = True
    """Whether the environment of all agents has one reward, so that agents cannot be paid alone."""
    _viewer: Any = None

    def _setup(
        self,
        scenario: str | Scenario,
        n_env: int,
        render_mode: str | None,
        info: InfoLevel,
        overrides: dict[str, Any],
        *,
        joint: bool,
    ) -> None:
        from dcgrid_env.engine.family_simulation import simulation  # brings the compiler with it, so not on import

        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ValueError(f"render_mode is {render_mode!r}; choose one of {', '.join(RENDER_MODES)}, or None")
        if info not in INFO_LEVELS:
            raise ValueError(f"info is {info!r}; choose one of {', '.join(INFO_LEVELS)}")
        try:
            self.scenario = make_scenario(scenario, **overrides)
        except UnknownArgumentError as error:
            # TorchRL looks for Python's words before it makes the environment again without the argument.
            message = f"{error}; {type(self).__name__}() got an unexpected keyword argument {error.field!r}"
            raise TypeError(message) from None
        self._drawn_on: Scenario | None = None  # what the viewer shows
        if render_mode is not None and n_env > 1 and isinstance(self.scenario.feeder, RandomFeeders):
            raise ScenarioError("render_mode: environments on random feeders are not drawn together; give num_envs=1")
        if joint and self.pays_team and self.scenario.cost.reward == "local":
            raise ScenarioError("reward='local' pays each agent alone; use parallel_env, or reward='shared'")
        if self.scenario.sensing.observe == "feeder":
            subject = f"scenario {self.scenario.name!r}: observe is 'feeder', so that each observation"
            warn_if_huge(self.scenario, subject, "'local' or 'neighbours' does not grow with the feeder")
        self.render_mode, self.info_level = render_mode, info
        ids = self.scenario.feeder.bus_ids
        self._bus_ids = np.array(bus_numbers(ids) or ids)  # numbers where all are, which clients make tensors of
        self._simulation: Simulation = simulation(self.scenario, n_env)
        self._last: Transition | None = None
        self._cut_at, self._cuts = 0, 0  # step at which the last episodes were reset before their end, and how many

    @property
    def transition(self) -> Transition:
        """Result of the last step or reset, before any automatic reset; arrays over environments."""
        return self._simulation.transition if self._last is None else self._last

    def save(self) -> Snapshot:
        """Return the complete state; ``restore`` accepts it, in this or another environment of the same kind."""
        return self._simulation.now

    def restore(self, snapshot: Snapshot) -> None:
        """Continue from a saved state; ValueError for another scenario or number of environments."""
        self._simulation.restore(snapshot)
        self._arrived()

    def buses(self) -> np.ndarray:
        """Name of each agent's bus, (row, n_agent); RuntimeError before the first reset."""
        return self._bus_ids[self._simulation.now.episode.buses]

    def render(self) -> Any:
        """Draw the feeder and the running curves: an image (height, width, 3) uint8, or a window for "human"."""
        return self._drawable().draw()

    def _drawable(self) -> Any:
        if self.render_mode is None:
            raise RuntimeError("render needs a render_mode; make the environment with 'rgb_array' or 'human'")
        if self._viewer is None:
            raise RuntimeError("the environment has not been reset; call reset() before render()")
        return self._viewer

    def close(self, **kwargs: object) -> None:
        """Close the window, if one is open."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    def _reset(
        self,
        seeds: list[int | None],
        rng: np.random.Generator,
        mask: np.ndarray | None = None,
        episode_options: EpisodeOptions | None = None,
    ) -> Transition:
        """Begin episodes; draw a seed if none was ever given."""
        if not self._simulation.has_begun:
            seeds = [int(rng.integers(2**63)) if seed is None else seed for seed in seeds]
        elif self._simulation.n_env == 1:
            self._warn_about_cuts()
        transition = self._simulation.reset(seeds, mask, episode_options)
        self._arrived()
        return transition

    def _warn_about_cuts(self) -> None:
        """Warn, once, before a reset if the last episodes ended at the same step, before the horizon.

        A time limit that is put around the environment cannot be seen from within, but its resets can. A single step
        is no episode: checkers of environments take one.
        """
        now = self._simulation.now
        steps = int(now.step[0])
        if now.over[0]:
            self._cuts = 0
        elif steps > 0:
            self._cuts = self._cuts + 1 if steps == self._cut_at else 1
            self._cut_at = steps
        if self._cuts == CUTS and steps > 1:
            warnings.warn(
                f"{CUTS} episodes in a row were reset at step {steps}, before the end at step {self.scenario.horizon}: "
                f"what an episode is charged at its end, such as work left over, was left out; for episodes of {steps} "
                f"steps pass horizon={steps} instead of a time limit around the environment",
                EpisodeCutWarning,
                stacklevel=4,
            )

    def _step(self, action: np.ndarray) -> Transition:
        transition = self._simulation.step(action)
        if self._viewer is not None:
            self._show()
        return transition

    def _arrived(self) -> None:
        """Update the agents' buses and the picture after a reset or restore."""
        self._last = None
        self._bus_names = self.buses()
        if self.render_mode is not None:
            on = self._simulation.scenario_of(0)
            if self._drawn_on is not on:
                self.close()
                self._drawn_on = on
            if self._viewer is None:
                from dcgrid_env.rendering.viewer import Viewer

                n_env = 1 if self.render_mode == "human" else self._simulation.n_env
                self._viewer = Viewer(on, self.render_mode, n_env)
            self._show()

    def _show(self) -> None:
        self._viewer.record(self._simulation.now)
        if self.render_mode == "human":
            self._viewer.draw()
