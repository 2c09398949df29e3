"""PettingZoo environment: every data centre, inverter or other device is an agent."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils import parallel_to_aec

from dcgrid_env.core.seeds import as_seed
from dcgrid_env.engine.cost import observation
from dcgrid_env.engine.physics.actions import action_layout, joined_actions
from dcgrid_env.engine.physics.parameters import parameters
from dcgrid_env.envs.base import BaseEnvironment, check_running, warn_if_huge
from dcgrid_env.envs.class_docs import documented
from dcgrid_env.envs.info import InfoLevel, drop_step_keys, info_arrays
from dcgrid_env.envs.time_limit import with_horizon
from dcgrid_env.scenario.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.engine.simulation import Snapshot, Transition


STATE_BOUND = 1e4
"""Bound of the global state's entries: far beyond any voltage deviation in bands or any backlog in seconds."""


@documented
class DcgridParallelEnv(BaseEnvironment, ParallelEnv[str, np.ndarray, Any]):
    """Voltage control of a distribution feeder as a PettingZoo environment, with an agent for each device.

    Problem
    -------
    {problem}

    The agents are dc_0, dc_1 and so on, then inv_0, inv_1 and so on. They are the same in every episode.

    Action space
    ------------
    ``Box(-1, 1, (n_channel,), float32)`` for each agent.

    {actions}

    Observation space
    -----------------
    ``Box(low, high, (n_field,), float32)`` for each agent. ``state()`` returns the global state.

    {observations}

    Reward
    ------
    Every agent receives the same reward. With ``reward="local"`` each agent is charged for its own voltage, work and
    effort instead. With ``reward="difference"`` it is paid for the cost that its own action saves in the step.

    {reward}

    Starting state
    --------------
    {start}

    Episode end
    -----------
    {end} All agents end together.

    Information
    -----------
    ``infos[agent]`` has NumPy scalars, and the bus of the agent under the key "bus". That of a reset does not have the
    keys that belong to a step. TorchRL's PettingZooWrapper needs the same keys at both, so ``info="none"``.

    {info}

    Parameters
    ----------
    scenario
        Name of a scenario, or a Scenario.
    render_mode
        None, "rgb_array" or "human".
    max_cycles
        Steps in an episode (default: the horizon of the scenario).
    info
        Contents of each agent's ``info``: "full", "costs" or "none".
    **overrides
        Fields of the scenario to override, for instance ``reward="local", observe="neighbours"``.

    Examples
    --------
    >>> import dcgrid_env
    >>> env = dcgrid_env.parallel_env("ieee33", horizon=60)
    >>> observations, infos = env.reset(seed=0)
    >>> actions = {agent: env.action_space(agent).sample() for agent in env.agents}
    >>> observations, rewards, terminations, truncations, infos = env.step(actions)
    """

    metadata = {  # noqa: RUF012 (pettingzoo declares it so)
        "render_modes": ["human", "rgb_array"],
        "render_fps": 10,
        "name": "dcgrid_v0",
        "is_parallelizable": True,
    }

    def __init__(
        self,
        scenario: str | Scenario = "ieee123",
        *,
        render_mode: str | None = None,
        max_cycles: int | None = None,
        info: InfoLevel = "full",
        **overrides: object,
    ):
        overrides = with_horizon(overrides, "max_cycles", max_cycles)
        self._setup(scenario, 1, render_mode, info, overrides, joint=False)
        s = self.scenario
        self.max_cycles = s.horizon
        self.possible_agents = list(s.agents)
        self.agents: list[str] = []
        bounds = observation.bounds(s)
        self.observation_spaces: dict[str, spaces.Space[np.ndarray]] = {
            a: spaces.Box(*bounds[a], dtype=np.float32) for a in s.agents
        }
        layout = action_layout(s)
        low, high = layout.bounds
        self.action_spaces: dict[str, spaces.Space[np.ndarray]] = {
            a: spaces.Box(low[entries], high[entries], dtype=np.float32) for a, entries in layout.slices.items()
        }
        cuts = np.cumsum([0, *(len(low) for low, _ in bounds.values())]).tolist()
        self._slices = {a: slice(*cuts[i : i + 2]) for i, a in enumerate(s.agents)}
        fields = zip(s.devices, observation.device_fields(s), strict=True)
        n_device = sum(device.count * len(names) for device, names in fields)
        n_state = len(s.feeder.load_nodes) + 2 * s.n_agents + n_device + 1
        self.state_space = spaces.Box(-STATE_BOUND, STATE_BOUND, (n_state,), np.float32)
        self._rng, _ = seeding.np_random()

    def observation_space(self, agent: str) -> spaces.Space[np.ndarray]:
        """Return an agent's observation space, the same object at each call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[np.ndarray]:
        """Return an agent's action space, the same object at each call."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Begin a seed's first episode, or the next one if no seed is given."""
        transition = self._reset([as_seed(seed)], self._rng)
        self.agents = list(self.possible_agents)
        infos = self._infos(transition)
        for info in infos.values():
            drop_step_keys(self.scenario, info)
        return self._observations(transition), infos

    def step(self, actions: dict[str, np.ndarray]) -> tuple[
        dict[str, np.ndarray], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]
    ]:  # fmt: skip
        """Advance one step; ActionError names the agent whose action cannot be used."""
        check_running(self)
        transition = self._step(joined_actions(self.scenario, actions))
        everyone = self.possible_agents
        paid = transition.reward[0]
        rewards = paid.tolist() if paid.ndim else [float(paid)] * len(everyone)
        terminated, truncated = bool(transition.terminated[0]), bool(transition.truncated[0])
        if terminated or truncated:
            self.agents = []
        return (
            self._observations(transition),
            dict(zip(everyone, rewards, strict=True)),
            dict.fromkeys(everyone, terminated),
            dict.fromkeys(everyone, truncated),
            self._infos(transition),
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Continue from a saved state."""
        super().restore(snapshot)
        self.agents = [] if self._simulation.now.over[0] else list(self.possible_agents)

    def state(self) -> np.ndarray:
        """Return the global state, float32.

        The state contains, in this order:

        - (V - 1) / band of every node except the substation's.
        - Draw and reactive injection of every agent, as shares of its rating and limit.
        - The fields of every device, each over its slots, including the preview even if agents do not observe it. For
          a data centre these are p_ref over the coming interval, as a share of its rating, and the backlog, in seconds
          at the rating. A clock law of two work classes adds the compute-bound parts of both.
        - The share of the episode that has passed.
        """
        from dcgrid_env.engine.exogenous import episode  # brings the compiler with it, so not on import

        warn_if_huge(self.scenario, "state()", "take what you need of env.transition.state instead")
        s, now = self.scenario, self._simulation.now
        params = parameters(s, now.state.p_kw)
        next_input = episode.given_next(s, now.episode, now.step, now.p_ref_next_kw)
        parts = [
            (now.state.v_pu[0, s.feeder.load_slice] - 1.0) / (s.cost.band_pu or 1.0),
            now.state.p_kw[0] / params.p_scale_kw,
            now.state.q_kvar[0] * params.per_q_scale,
        ]
        of_devices = zip(
            s.devices, observation.device_fields(s), params.devices, now.state.devices, next_input, strict=True
        )
        for device, fields, device_params, its_state, device_input in of_devices:
            raw = device.observe(device_params, its_state, device_input)
            parts += [figure[0] / field.share_of for field, figure in zip(fields, raw, strict=True)]
        parts.append(now.step / s.horizon)
        return np.clip(np.concatenate(parts), -STATE_BOUND, STATE_BOUND).astype(np.float32)

    def _observations(self, transition: Transition) -> dict[str, np.ndarray]:
        joint = transition.observation[0].copy()
        return {agent: joint[cut] for agent, cut in self._slices.items()}

    def _infos(self, transition: Transition) -> dict[str, dict[str, Any]]:
        common = {name: values[0] for name, values in info_arrays(self.scenario, transition, self.info_level).items()}
        infos: dict[str, dict[str, Any]] = {agent: common.copy() for agent in self.possible_agents}
        if transition.reward_vector is not None and self.info_level != "none":
            for agent, vector in action_layout(self.scenario).split(transition.reward_vector[0].copy()).items():
                infos[agent]["reward_vector"] = vector
        if self.info_level == "full":
            for agent, bus in zip(self.possible_agents, self._bus_names[0], strict=True):
                infos[agent]["bus"] = bus
        return infos


def parallel_env(
    scenario: str | Scenario = "ieee123",
    *,
    render_mode: str | None = None,
    max_cycles: int | None = None,
    info: InfoLevel = "full",
    **overrides: object,
) -> DcgridParallelEnv:
    """Make the multi-agent environment of a scenario, see :class:`DcgridParallelEnv`."""
    return DcgridParallelEnv(scenario, render_mode=render_mode, max_cycles=max_cycles, info=info, **overrides)


def env(
    scenario: str | Scenario = "ieee123",
    *,
    render_mode: str | None = None,
    max_cycles: int | None = None,
    info: InfoLevel = "full",
    **overrides: object,
) -> AECEnv[str, Any, Any]:
    """Make the environment in PettingZoo's AEC form: agents act in turn, the grid steps after the last."""
    turns = parallel_env(scenario, render_mode=render_mode, max_cycles=max_cycles, info=info, **overrides)
    return parallel_to_aec(turns)
