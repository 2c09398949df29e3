"""Write a policy as a folder in the layout of the Hugging Face hub, with a model card; nothing is uploaded.

README.md            model card: YAML metadata with the test figures, and how to load the policy
policy.safetensors   weights and settings, read by ``Policy.load``
policy.json          card of the policy
config.json          scenario and hash of the test, settings of the policy, and configuration of its training

The metadata follow the model cards of reinforcement learning on the hub
(https://huggingface.co/docs/hub/model-cards, https://github.com/huggingface/hub-docs/blob/main/modelcard.md).
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tyro

from dcgrid_env import IDS, METRICS, PRESETS, Scenario, scenario_hash
from dcgrid_env.agents.controllers import without_horizon
from dcgrid_env.agents.policy.card import Card
from dcgrid_env.agents.policy.neural_network import PolicyError
from dcgrid_env.agents.policy.policy import FOLDER, SHIPPED, Policy
from dcgrid_env.agents.policy.policy_file import SUFFIX
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.agents.training.config import FREE, stored_config
from dcgrid_env.baselines import make_controller, published
from dcgrid_env.baselines.evaluation import Evaluation, evaluate
from dcgrid_env.baselines.hindsight_costs import FOLDER as HINDSIGHT
from dcgrid_env.baselines.registry import controller_file
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.baselines.score import REFERENCE, SAVED, SPLIT, Estimate, Score, saved
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.settings import Overrides, check_folder
from dcgrid_env.core.commands.terminal import plain_console, say, working
from dcgrid_env.core.files import whole_folder, write_bytes, write_json, write_text
from dcgrid_env.core.user_files import is_file
from dcgrid_env.core.versions import PACKAGES, code_block, versions

README, CONFIG, WEIGHTS = "README.md", "config.json", f"policy{SUFFIX}"
LIBRARY, TASK = "dcgrid-env", "reinforcement-learning"
FORMAT = 1
"""Version of the form of config.json."""
_LICENSE = re.compile(r"[a-z0-9][a-z0-9.+-]*")


class Tested(NamedTuple):
    """Figures of a policy on test episodes."""

    spec: ScenarioSpec
    policy: Evaluation
    droop: Evaluation
    score: Score | None
    """None if hindsight costs of the episodes are not stored."""

    @property
    def scenario(self) -> Scenario:
        """Scenario of the test split."""
        return self.policy.scenario

    @property
    def environment(self) -> str | None:
        """Gymnasium id; None if the scenario is not an unchanged preset."""
        ids = {name: gym_id for gym_id, name in IDS.items()}
        return ids[self.spec.where] if self.spec.is_preset else None

    @property
    def returns(self) -> np.ndarray:
        """Sum of rewards of each episode, (n_episode,): minus J times the number of steps."""
        return -self.policy.J * self.scenario.horizon


def export_hub(
    policy: str, out: Path, scenario: ScenarioSpec | None = None, episodes: int = 100, license: str = "mit"
) -> Tested:
    """Test a policy and write the folder.

    Parameters
    ----------
    policy
        Folder of a training run, policy file, or name of a bundled policy.
    out
        Folder to create.
    scenario
        Scenario of the test; default: the preset of the training.
    episodes
        Number of test episodes, with seeds 0, 1, ...
    license
        License of the policy, an identifier of the hub.

    Returns
    -------
    Tested
        The test figures in the model card.

    Raises
    ------
    ValueError
        If a setting is invalid, before anything is written. PolicyError, a ValueError, if the policy cannot be read or
        has no card.
    """
    if episodes < 2:
        raise ValueError(f"episodes: must be at least 2 for an interval, got {episodes}")
    if not _LICENSE.fullmatch(license):
        raise ValueError(
            f"license: must be an identifier of the hub in lower case, got {license!r}; for example mit, apache-2.0, "
            "cc-by-4.0 or other"
        )
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ValueError(f"out: must be a new or empty folder, got {str(out)!r}; choose another folder")
    path = _weights(policy)
    loaded = Policy.load(path)
    card = loaded.card
    if card is None:
        missing = path.with_suffix(".json")
        raise PolicyError(f"policy: there is no card {missing}; copy it from where the policy was saved")
    tested = _tested(loaded, _spec(policy, loaded, scenario), range(episodes))
    training = stored_config(path.parent) if Path(policy).is_dir() else None
    with whole_folder(out) as folder:
        write_bytes(folder / WEIGHTS, path.read_bytes())
        write_bytes(folder / "policy.json", path.with_suffix(".json").read_bytes())
        write_json(folder / CONFIG, _config(loaded, tested, training))
        write_text(folder / README, model_card(card, tested, license))
    return tested


def _weights(policy: str) -> Path:
    """Return the weights' file of a policy; raise ValueError for anything else."""
    if policy in SHIPPED:
        return FOLDER / f"{policy}{SUFFIX}"
    path = controller_file(policy)
    if path is None or path.suffix != SUFFIX:
        raise ValueError(
            f"policy: must be the folder of a training run, a {SUFFIX} file or a bundled policy, got {policy!r}; "
            "dcgrid list controllers lists the bundled ones"
        )
    if not is_file(path, ValueError):
        raise ValueError(f"policy: there is no file {path}; give the folder of a completed training run")
    return path


def _spec(policy: str, loaded: Policy, scenario: ScenarioSpec | None) -> ScenarioSpec:
    trained_on = without_horizon(loaded.trained_on)
    if scenario is None and trained_on not in PRESETS:
        raise ValueError(
            f"scenario: must be given for policy {policy!r}, which was trained on {loaded.trained_on!r}, not on a "
            "preset; add --scenario (dcgrid list)"
        )
    return scenario or ScenarioSpec(trained_on)


def _tested(policy: Policy, spec: ScenarioSpec, seeds: range) -> Tested:
    test = spec.make(SPLIT)
    with on_purpose():  # the scenario was asked for
        evaluation = evaluate(policy, test, seeds)
    droop, hindsight = evaluate(make_controller(REFERENCE, test), test, seeds), published(test, HINDSIGHT)
    scored = None
    if hindsight is not None and not hindsight.missing(seeds):
        scored = evaluation.score(droop, hindsight)
    return Tested(spec, evaluation, droop, scored)


def _config(policy: Policy, tested: Tested, training: Mapping[str, Any] | None) -> dict[str, Any]:
    test = tested.scenario
    return {
        "format": FORMAT,
        "library_name": LIBRARY,
        "versions": versions(PACKAGES),
        "environment": tested.environment,
        "scenario": {
            "name": tested.spec.label,
            "split": test.split,
            "hash": scenario_hash(test),
            "episodes": len(tested.policy.seeds),
        },
        "policy": {
            "kind": policy.kind,
            "observe": policy.observe,
            "preview": policy.preview,
            "act": policy.acts,
            "outputs": policy.outputs,
            "n_parameters": policy.n_parameters,
            "sha256": policy.sha256,
        },
        "training": training and {name: value for name, value in training.items() if name not in FREE},
    }


def model_card(card: Card, tested: Tested, license: str) -> str:
    """Return README.md: YAML metadata and text."""
    name, where = f"{tested.scenario.name}-{card.algorithm or 'policy'}", tested.environment or tested.spec.label
    metrics = [
        _metric("mean_reward", "mean_reward", _spread(tested.returns, 2)),
        _metric("J", "J, mean cost per step (lower is better)", _spread(tested.policy.J, 4)),
    ]
    if tested.score is not None:
        metrics.append(
            _metric(
                "score", "score (0: tuned droop, 1: hindsight or best known cost)", _interval(tested.score.score, 3)
            )
        )
    metadata = {
        "license": license,
        "library_name": LIBRARY,
        "pipeline_tag": TASK,
        "tags": [TASK, "deep-reinforcement-learning", "power-systems", "voltage-control", "gymnasium", where],
        "model-index": [
            {
                "name": name,
                "results": [
                    {
                        "task": {"type": TASK, "name": TASK},
                        "dataset": {"name": where, "type": where},
                        "metrics": metrics,
                    }
                ],
            }
        ],
    }
    return "\n".join(["---", *_yaml(metadata), "---", "", *_text(name, card, tested, where)])


def _metric(kind: str, name: str, value: str) -> dict[str, Any]:
    return {"type": kind, "name": name, "value": value, "verified": False}


def _text(name: str, card: Card, tested: Tested, where: str) -> Iterable[str]:
    test, n = tested.scenario, len(tested.policy.seeds)
    yield f"# {name}"
    yield ""
    yield (
        "A policy for voltage control of a distribution feeder with AI data centres, trained with dcgrid-env "
        f"{card.version} ({card.algorithm or 'algorithm not recorded'}, {card.n_parameters} parameters). It was "
        "trained and tested in simulation only."
    )
    yield "\n## Use\n"
    yield "Install dcgrid-env, and download this folder. Reading the policy runs no code and needs no torch.\n"
    if tested.environment:
        yield "```python"
        yield from (
            "from dcgrid_env import make_scenario",
            "from dcgrid_env.agents import Policy, evaluate",
            "",
            f'policy = Policy.load("{WEIGHTS}")',
            f'scenario = make_scenario("{tested.spec.where}", split="{test.split}")',
            f'print(evaluate(policy, scenario, range({n})).means["J"])',
        )
        yield "```\n"
    yield code_block(f"dcgrid evaluate {WEIGHTS} {tested.spec.options('--scenario')} --episodes {n}")
    yield "\n## Environment\n"
    yield f"- environment: `{where}`"
    yield f"- scenario hash on the {test.split} split: `{scenario_hash(test)}` (`dcgrid_env.scenario_hash`)"
    yield f"- trained on: `{card.scenario}`"
    yield "- on other scenarios, load it with `dcgrid_env.agents.guarded`, which bounds its deviation from a droop law"
    yield "\n## Test figures\n"
    yield (
        f"{n} episodes of the {test.split} split, seeds 0 to {n - 1}. After +/-: standard deviation over episodes. In "
        "parentheses: 95 % interval over episodes, and for the mean over seeds and episodes.\n"
    )
    yield from _figures(card, tested)
    yield "\n## Training\n"
    yield f"Seed {card.seed}. Command:\n" if card.seed is not None else "Command:\n"
    yield code_block(card.command or "not recorded")
    yield ""


def _figures(card: Card, tested: Tested) -> Iterable[str]:
    delay, policy, droop, scored = METRICS["delay_mean_s"], tested.policy, tested.droop, card.scored
    droop_returns = _spread(-droop.J * tested.scenario.horizon, 2)
    rows = [
        ("figure", "policy", REFERENCE),
        ("---", "---:", "---:"),
        (
            "mean_reward, sum over the episode",
            _spread(tested.returns, 2),
            droop_returns,
        ),
        ("J", _spread(policy.J, 4), _spread(droop.J, 4)),
        (SAVED, _interval(saved(policy.J, droop.J), 2), "0"),
    ]
    if tested.score is not None:
        rows.append(("score", _interval(tested.score.score, 3), "0"))
    if scored is not None and scored.over_seeds and scored.scenario_hash == scenario_hash(tested.scenario):
        label = f"score, mean over {len(scored.seeds)} training seeds, {scored.episodes} episodes"
        rows.append((label, _interval(Estimate(*scored.over_seeds), 3), "0"))
    rows.append(("mean delay, s", delay.text(policy.means[delay.name]), delay.text(droop.means[delay.name])))
    for row in rows:
        yield f"| {' | '.join(row)} |"
    if tested.score is None:
        yield "\nNo score: hindsight costs of these episodes are not stored."


def _spread(values: np.ndarray, digits: int) -> str:
    """Mean and standard deviation, as the hub's cards write them."""
    return f"{values.mean():.{digits}f} +/- {values.std():.{digits}f}"


def _interval(estimate: Estimate, digits: int) -> str:
    return f"{estimate.value:.{digits}f} ({estimate.low:.{digits}f} .. {estimate.high:.{digits}f})"


def _yaml(value: Any) -> list[str]:
    """Return a mapping or sequence of text and flags as lines of YAML; text is quoted as in JSON, which YAML reads."""
    if isinstance(value, Mapping):
        lines = []
        for name, inner in value.items():
            if isinstance(inner, Mapping | list):
                lines += [f"{name}:", *(f"  {line}" for line in _yaml(inner))]
            else:
                lines.append(f"{name}: {json.dumps(inner)}")
        return lines
    lines = []
    for inner in value:
        first, *rest = _yaml(inner) if isinstance(inner, Mapping) else [json.dumps(inner)]
        lines += [f"- {first}", *(f"  {line}" for line in rest)]
    return lines


@dataclass(frozen=True)
class ExportHub(Command):
    """Write a policy as a folder for the Hugging Face hub.

    The folder has a model card (README.md) with the policy's figures on the test split, the policy with its card, and
    the configuration. Nothing is uploaded.
    """

    policy: tyro.conf.Positional[str]
    """Policy: a training run's folder, a policy file or a bundled policy (dcgrid list)."""
    out: Path
    """Folder to create; it must be new or empty."""
    scenario: str | None = None
    """Scenario of the test: a name (dcgrid list), path/to/file.toml, path/to/file.py:function or
    package.module:function. Default: the preset that the policy was trained on."""
    set: Overrides = ()
    """Fields of --scenario to override, for example --set horizon=60."""
    episodes: int = 100
    """Number of test episodes, at least 2, with seeds 0, 1, ..."""
    license: str = "mit"
    """License of the policy, as the hub abbreviates it, for example mit, apache-2.0 or cc-by-4.0."""

    def run(self) -> None:
        """Test, write and print; raise ValueError before writing if a setting is invalid."""
        if self.set and self.scenario is None:
            raise ValueError(f"set: must be given with --scenario, got {' '.join(self.set)}; add --scenario")
        check_folder(self.out)
        spec = None if self.scenario is None else ScenarioSpec(self.scenario, self.set)
        console = plain_console()
        with working(console, f"{self.episodes} test episodes"):
            tested = export_hub(self.policy, self.out, spec, self.episodes, self.license)
        figures = f"J {tested.policy.means['J']:.4f}, tuned droop {tested.droop.means['J']:.4f}"
        say(console, f"{tested.scenario.name}, {tested.scenario.split} split: {figures}")
        say(console, f"wrote {self.out}; upload it with the hub's client: hf upload USER/NAME {self.out}")
