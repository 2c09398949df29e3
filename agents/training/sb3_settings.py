"""Settings of Stable-Baselines3's algorithms with which they learn on the rows of ``sb3_vec_env``.

The settings are the same for every scenario. Decision 51 has the measurements by which they were chosen.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dcgrid_env import acting_relays
from dcgrid_env.agents.training.row_batch import observation_scaling
from dcgrid_env.agents.training.row_form import RowActions

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecEnv

    from dcgrid_env.agents.training.batched_envs import RowVecEnv


def ppo_settings(envs: VecEnv, steps: int = 60_000) -> dict[str, Any]:
    """Return keyword arguments for Stable-Baselines3's PPO, as in ``PPO(env=envs, **ppo_settings(envs))``.

    A rollout has 480 decisions of all environments together, so that the policy is improved often, and in a training of
    more than 60,000 steps a 125th of these. It has 320 where a decision lasts for 10 s or more. Where rewards of later
    steps count it has 960, and the policy changes more slowly. If relays of regulators act, it has 960 too, and
    exploration is narrower, because exploration makes relays tap.

    The policy scales its observations itself, by the means and standard deviations in one episode of eight environments
    with small random actions. A saved model therefore needs no file of VecNormalize.

    Parameters
    ----------
    envs
        Result of :func:`sb3_vec_env`, also inside wrappers such as VecMonitor.
    steps
        Steps of all environments together that the training will have.

    Raises
    ------
    TypeError
        If the environments are not those of :func:`sb3_vec_env`.
    ValueError
        If ``steps`` is less than 1, or a wrapper changes the observations, as VecNormalize does. Make the settings from
        the environments without it, and replace ``policy_kwargs``.
    """
    from stable_baselines3.common.utils import LinearSchedule

    if steps < 1:
        raise ValueError(f"steps is {steps}; give the steps of the training, at least 1")
    made = rows_of(envs)
    gamma = discount(made)
    is_single = gamma < 0.5  # what follows a decision hardly counts
    makes_taps = gamma == 0.0 and acting_relays(made.scenario) is not None
    fewest = 960 if makes_taps or not is_single else 480 if gamma == 0.0 else 320
    decisions = max(fewest, steps // 125) if gamma == 0.0 else fewest
    n_steps = max(2, min(decisions // made.n_envs, made.rows.n_decisions))
    n_minibatches = 4 if decisions <= 960 else 8
    return {
        "policy": "MlpPolicy",
        "gamma": gamma,
        "gae_lambda": gamma,
        "n_steps": n_steps,
        "batch_size": max(2, -(-n_steps * made.num_envs // n_minibatches)),
        "n_epochs": 3,
        "learning_rate": LinearSchedule(3e-3 if is_single else 1e-3, 0.0, 1.0),
        "policy_kwargs": {"log_std_init": -1.0 if is_single and not makes_taps else -2.0, **scaled_observations(made)},
        "device": "cpu",
    }


def sac_settings(envs: VecEnv) -> dict[str, Any]:
    """Return keyword arguments for Stable-Baselines3's SAC, as in ``SAC(env=envs, **sac_settings(envs))``.

    See :func:`ppo_settings`. The weight of the entropy starts near its final value, and actions at the one of the
    droop: no random actions precede the training.
    """
    from stable_baselines3.common.utils import LinearSchedule

    made = rows_of(envs)
    return {
        "policy": "MlpPolicy",
        "gamma": discount(made),
        "learning_rate": LinearSchedule(3e-3, 0.0, 1.0),
        "batch_size": 2048,
        "buffer_size": 2000 * made.num_envs,
        "learning_starts": 0,
        "gradient_steps": 1,
        "ent_coef": "auto_0.01",
        "target_entropy": 0.2 * made.action_space.shape[0],  # pyright: ignore[reportOptionalSubscript]
        "policy_kwargs": {"net_arch": [64, 64], "n_critics": 1, **scaled_observations(made)},
        "device": "cpu",
    }


def td3_settings(envs: VecEnv) -> dict[str, Any]:
    """Return keyword arguments for Stable-Baselines3's TD3, as in ``TD3(env=envs, **td3_settings(envs))``.

    See :func:`sac_settings`. Exploration is normal noise with a standard deviation of 0.2.
    """
    from stable_baselines3.common.noise import NormalActionNoise
    from stable_baselines3.common.utils import LinearSchedule
    from torch.nn import Tanh

    settings = {name: value for name, value in sac_settings(envs).items() if name not in ("ent_coef", "target_entropy")}
    settings["policy_kwargs"] |= {"activation_fn": Tanh}
    n_action = envs.action_space.shape[0]  # pyright: ignore[reportOptionalSubscript]
    noise = NormalActionNoise(np.zeros(n_action), np.full(n_action, 0.2))
    return settings | {"learning_rate": LinearSchedule(2e-3, 0.0, 1.0), "action_noise": noise, "policy_delay": 1}


def discount(made: RowVecEnv) -> float:
    """Return the discount: 0 for a difference reward, which charges later costs at once, else 0.9 for each second."""
    if made.scenario.cost.reward == "difference":
        return 0.0
    return 0.9 ** (made.scenario.dt_s * made.rows.action_repeat)


def rows_of(envs: VecEnv) -> RowVecEnv:
    """Return what ``sb3_vec_env`` made, without wrappers; see :func:`ppo_settings` for what is refused."""
    from stable_baselines3.common.vec_env import VecNormalize

    made: Any = envs.unwrapped
    if not isinstance(envs.action_space, RowActions) or not hasattr(made, "rows"):
        raise TypeError(f"envs is a {type(made).__name__}; give environments made by sb3_vec_env")
    wrapper: Any = envs
    while wrapper is not made:
        is_scaled = isinstance(wrapper, VecNormalize) and wrapper.norm_obs
        if is_scaled or wrapper.observation_space != made.observation_space:
            raise ValueError(
                f"envs has the wrapper {type(wrapper).__name__}, which changes the observations that the policy "
                "scales; make the settings from environments without it"
            )
        wrapper = wrapper.venv
    return made


def scaled_observations(made: RowVecEnv) -> dict[str, Any]:
    """Return policy arguments that scale observations, see :func:`observation_scaling`."""
    from dcgrid_env.agents.training.sb3_models import Normalised

    moments = {name: values.tolist() for name, values in observation_scaling(made.rows)._asdict().items()}
    return {"features_extractor_class": Normalised, "features_extractor_kwargs": moments}
