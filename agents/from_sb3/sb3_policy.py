"""A Stable-Baselines3 actor as a policy of NumPy arrays for a scenario, of either of the views in which SB3 trains."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env import Scenario, under_own_control
from dcgrid_env.agents.from_sb3.sb3_zip import REMEDY, Actor
from dcgrid_env.agents.policy.neural_network import PolicyError
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.training.row_form import RowForm
from dcgrid_env.agents.training.rows import Rows, make_rows
from dcgrid_env.agents.training.sb3_models import networks_of
from dcgrid_env.baselines.scenario_spec import ScenarioSpec


class Normalisation(NamedTuple):
    """What VecNormalize does to observations: clip((x - mean) / std, -clip, clip), (n_observation,) each."""

    mean: np.ndarray
    std: np.ndarray
    clip: float


def rows_for(scenario: Scenario, widths: tuple[int, int]) -> Rows:
    """The rows whose observation and action have these widths.

    That of ``gymnasium.make``, of all agents or without regulators and capacitor banks, or the shared view of
    ``sb3_vec_env``. PolicyError, saying which widths there are, where neither fits.
    """
    others, looked_at = under_own_control(scenario, keep_set_points=True), []
    for view, seen in (
        ("joint", scenario), ("joint", others), ("shared", others),
    ):  # fmt: skip
        rows = make_rows(seen, RowForm(view))
        if (rows.n_observation, rows.n_action) == widths:
            return rows
        looked_at.append(f"{rows.n_observation} and {rows.n_action} ({view})")
    raise PolicyError(
        f"observation and action have {widths[0]} and {widths[1]} figures; on {scenario.name} they have "
        f"{', '.join(dict.fromkeys(looked_at))}: name the scenario that it was trained on, or {REMEDY}"
    )


def as_policy(actor: Actor, spec: ScenarioSpec, made_with: str, normalisation: Normalisation | None = None) -> Policy:
    """The policy whose actions are those of SB3's ``predict(deterministic=True)``, to the rounding of float32.

    Parameters
    ----------
    actor
        What :func:`read_actor` read.
    spec
        What it was trained on; its agents define the actor's inputs and outputs.
    made_with
        The command that makes it.
    normalisation
        That of the VecNormalize which it was trained behind.

    Raises
    ------
    PolicyError
        Where it does not fit the scenario's agents, or drives regulators or capacitor banks itself, and where it was
        trained behind a VecNormalize that is not given.
    """
    scenario = spec.make("train")
    if actor.is_normalised and normalisation is None:
        raise PolicyError(
            "it was trained behind VecNormalize, whose statistics are no part of the zip; give the file of its save "
            "with --normalize, and --trust, for that file is pickle"
        )
    rows, n = rows_for(scenario, actor.widths), actor.widths[0]
    if under_own_control(rows.scenario, keep_set_points=True) is not rows.scenario:
        raise PolicyError(
            f"it drives the regulators or capacitor banks of {scenario.name} too, which a policy leaves under their "
            f"own control; dcgrid evaluate takes the zip with --trust, or {REMEDY}"
        )
    if normalisation is not None and len(normalisation.mean) != n:
        raise PolicyError(
            f"normalize has {len(normalisation.mean)} figures and the observation {n}; give the file of this training"
        )
    networks = networks_of(rows, actor.layers, actor.activation, actor.squash, *(normalisation or (None, None, None)))
    return Policy(
        networks, observe=scenario.sensing.observe, preview=scenario.sensing.preview, scenario=spec.label,
        made_with=made_with,
        channels=rows.further_channels,
    )  # fmt: skip
