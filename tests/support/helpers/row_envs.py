"""Rows of a batch for Stable-Baselines3, by view."""

from typing import Any

from dcgrid_env.agents.training.batched_envs import RowVecEnv
from dcgrid_env.agents.training.row_form import RowForm
from dcgrid_env.agents.training.row_views import make_rows


def joint_envs(scenario: Any, n_envs: int) -> Any:
    return RowVecEnv(make_rows(scenario), n_envs)


def agent_envs(scenario: Any, n_envs: int, **form: Any) -> Any:
    return RowVecEnv(make_rows(scenario, RowForm("shared", **form)), n_envs)


def channel_envs(scenario: Any, n_envs: int, **form: Any) -> Any:
    return RowVecEnv(make_rows(scenario, RowForm("channel", **form)), n_envs)
