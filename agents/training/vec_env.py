"""The native batch as a vector environment of Stable-Baselines3."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dcgrid_env import Scenario
from dcgrid_env.agents.training.row_form import Outputs, View
from dcgrid_env.agents.training.row_views import learning_rows

if TYPE_CHECKING:
    from dcgrid_env.agents.training.batched_envs import RowVecEnv


def sb3_vec_env(
    scenario: str | Scenario,
    num_envs: int,
    view: View | None = None,
    *,
    outputs: Outputs | None = None,
    nameplate: bool | None = None,
    action_repeat: int | None = None,
    render_mode: str | None = None,
    **overrides: object,
) -> RowVecEnv:
    """Make a Stable-Baselines3 VecEnv that steps ``num_envs`` environments as one native batch.

    By default rows, actions and reward have the form with which training is fastest. A row is a channel of an agent,
    an action of 0 means no control, and training is paid by difference rewards. On random feeders each environment has
    another feeder. :func:`ppo_settings` returns the settings of PPO that go with it.
    ``view="joint", outputs="setpoint", reward="shared"`` is the form of ``gymnasium.make``.

    Its algorithms and wrappers (VecMonitor, EvalCallback) accept it unchanged. After ``seed(n)`` the next reset begins
    the episodes of seeds n, n + 1 and so on, one in each environment. A further reset begins the next episodes, and on
    the splits "validation" and "test" the same again, so that evaluations are compared on the same episodes. In the
    last step of an episode ``infos[row]`` has ``terminal_observation``, ``TimeLimit.truncated`` and the cost ``J``.

    In the views "shared" and "channel" several rows are one environment, and Stable-Baselines3 counts each row's end as
    an episode. Pass ``n_eval_episodes=envs.n_eval_episodes(10)`` to ``evaluate_policy`` or ``EvalCallback`` for ten
    different episodes. Steps, such as ``total_timesteps``, are counted once for each row too.

    Parameters
    ----------
    scenario
        Registered id, name of a preset, or a Scenario.
    num_envs
        Environments in the batch.
    view
        "joint": a row is an environment, with the observation of ``gymnasium.make``. "shared": a row is an
        agent, so that one policy drives all of them; the VecEnv has ``num_envs`` times the scenario's agents as rows,
        environment by environment. Observations are then an agent's own fields, 0 where it has none of the name. The
        last entry is 1 for a data centre or 0 for an inverter, with a further such entry for each other kind of agent.
        Actions are (clock, q) and then the other channels of the scenario's agents. Channels that an agent does not
        have are ignored, such as an inverter's clock. Each agent is paid the team's reward, or its own with
        ``reward="difference"``. "channel": a row is one channel of an agent, such as its clock or its reactive power,
        in the order of the joint action. Its action has one entry. Its observation is that of the shared view and then
        a figure for each channel, 1 for the row's own. With ``reward="difference"`` a row is paid its channel's entry.
        Default: "channel", or "joint" if regulators or capacitor banks are among the agents.
    outputs
        "setpoint": actions are set points, as in ``gymnasium.make``. "change": reactive power is a change from the
        present one, and a clock is reduced from the one that serves all work. "droop": actions are corrections of the
        tuned droop. Default: "change", on a few presets "droop", and "setpoint" if regulators or capacitor banks are
        among the agents.
    nameplate
        Whether to observe the effect of full demand and of full reactive power on the agent's voltage. The share of
        the latter that corrects the voltage is observed too. Not in the joint view. Default: in the other views.
    action_repeat
        Steps of the environment for which an action holds, a divisor of the horizon. Default: 1, or where agents choose
        the settings of power smoothing, the time for which these hold.
    render_mode
        None, "rgb_array" (an image of each environment) or "human" (a window shows the first environment).
    **overrides
        Any field of the Scenario, for instance ``horizon=60, split="validation"``. Default of ``reward`` on the split
        "train": "difference" with the action of 0 as ``cost.default_action``, or "local" where a difference reward is
        not defined; in the joint view "shared". On other splits the reward is minus the cost, so that ``EvalCallback``
        selects by J.

    Raises
    ------
    ImportError
        Where Stable-Baselines3 is not installed.
    ScenarioError
        For an unknown scenario; TypeError for an override that is not a field of it.
    ValueError
        For an unknown view or unknown outputs, nameplate figures in a joint view, or corrections of a droop without
        tuned gains. Also for another view than "joint" if regulators or capacitor banks are among the agents.
    """
    rows = learning_rows(scenario, view, outputs, nameplate, action_repeat, overrides)
    try:
        from dcgrid_env.agents.training.batched_envs import RowVecEnv
    except ImportError as error:
        raise ImportError(
            f"sb3_vec_env needs Stable-Baselines3 ({error}); install it with pip install 'stable-baselines3>=2.7'"
        ) from error
    return RowVecEnv(rows, num_envs, render_mode)
