"""Train unmodified reinforcement-learning libraries on presets, and score them on the test episodes."""

from __future__ import annotations

import ast
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from gymnasium import spaces

from dcgrid_env import scenario_hash
from dcgrid_env.baselines.evaluation import hindsight_costs
from dcgrid_env.baselines.score import Estimate, mean_over_seeds, score, score_error
from dcgrid_env.cli.command import Command
from dcgrid_env.cli.names import scenario_names, split_names
from dcgrid_env.cli.settings import at_least, check_file
from dcgrid_env.core.files import write_json
from dcgrid_env.core.versions import versions
from docs.studies.learning_tables import estimate
from docs.studies.library_batches import DISCOUNTS, EVALUATIONS, Batches, Setting, batches, example
from docs.studies.scored import droop_on_test, on_test

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

DATA, PAGE = Path("docs/rl-libraries.json"), Path("docs/rl-libraries.md")
MOST_EPISODES = 32
"""Test episodes whose hindsight is published for every preset."""


def sb3(model_class: str, policy: str, settings: Callable[[int], dict[str, Any]], on: Setting) -> np.ndarray:
    """Train an algorithm of Stable-Baselines3 or sb3-contrib, and return J of the test episodes, (episode,)."""
    of = batches(on)
    chosen = {"gamma": DISCOUNTS[on.reward], "seed": on.seed, "device": "cpu"} | settings(of.train.num_envs)
    return learned(resolve_name(model_class)(policy, of.train, **chosen), of, on)


def sb3_off_policy(model_class: str, settings: Callable[[int], dict[str, Any]], on: Setting) -> np.ndarray:
    """Train an algorithm with a replay buffer, and return J of the test episodes, (episode,).

    The actor maps to the whole action space, which is reduced to [-1, 1], and starts near the default action.
    """
    from docs.studies.library_loops import LOG_STD, initialise

    of = batches(on)
    of.train.action_space = spaces.Box(-1.0, 1.0, of.train.action_space.shape)
    chosen = {"gamma": DISCOUNTS[on.reward], "seed": on.seed, "device": "cpu"} | settings(of.train.num_envs)
    model = resolve_name(model_class)("MlpPolicy", of.train, **chosen)
    initialise(model.actor.mu, 0.01)
    if hasattr(model.actor, "log_std"):
        model.actor.log_std.bias.data.fill_(LOG_STD)
    return learned(model, of, on)


def learned(model: BaseAlgorithm, of: Batches, on: Setting) -> np.ndarray:
    """Train a model of Stable-Baselines3, and return J of the test episodes, (episode,)."""
    script, steps = example("difference_reward"), on.steps * of.train.num_envs // on.num_envs
    model.learn(steps, script.BestOnValidation(of.validation, every=steps // EVALUATIONS))
    of.test.obs_rms = of.validation.obs_rms
    return script.costs(model, of.test)


def loop(function: str, *arguments: Any) -> np.ndarray:
    """Train by a function, "module:name", whose module needs an optional library; return J of the test episodes."""
    return resolve_name(function)(*arguments)


class Library(NamedTuple):
    """A library's algorithm with its settings."""

    package: str
    """Distribution whose version is stored."""
    train: Callable[[Setting], np.ndarray]
    """Function that trains and returns J of each test episode."""
    steps: int
    """Default of ``Setting.steps``."""
    num_envs: int

    glue: tuple[str, ...] = ()
    """Further functions and classes of the same module that connect the library."""

    @property
    def glue_lines(self) -> int:
        """Lines of code that connect the library: its function, ``glue`` and ``batches``, without docstrings."""
        train: Any = self.train
        place = train.args[0] if train.func is loop else f"{train.func.__module__}:{train.func.__name__}"
        module, function = place.split(":")
        return code_lines(module, function, *self.glue) + code_lines(batches.__module__, batches.__name__)


def code_lines(module: str, *names: str) -> int:
    """Count the lines of code of functions and classes without their docstrings; the module is not imported."""
    spec = find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    text = Path(spec.origin).read_text(encoding="utf-8")
    lines: set[int] = set()
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name in names:
            lines |= set(range(node.lineno, (node.end_lineno or 0) + 1))
            for part in ast.walk(node):
                if isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant):
                    lines -= set(range(part.lineno, (part.end_lineno or 0) + 1))
    return sum(1 for number, line in enumerate(text.splitlines(), 1) if number in lines and line.strip())


def on_policy(n_rows: int) -> dict[str, Any]:
    """Return settings of PPO for a batch of rows: an episode in each, eight minibatches, a falling learning rate."""
    return {
        "n_steps": 120, "batch_size": 15 * n_rows, "n_epochs": 3, "gae_lambda": 0.0,
        "learning_rate": lambda left: 3e-3 * left, "policy_kwargs": {"log_std_init": -1.0},
    }  # fmt: skip


def recurrent(n_rows: int) -> dict[str, Any]:
    """Return settings of PPO with small recurrent networks."""
    networks = {"log_std_init": -1.0, "lstm_hidden_size": 32, "net_arch": [64]}
    return on_policy(n_rows) | {"policy_kwargs": networks}


def off_policy(learning_rate: float, batch_size: int, n_rows: int, **networks: Any) -> dict[str, Any]:
    """Return settings of algorithms with a replay buffer: small networks, large batches, a falling learning rate."""
    return {
        "learning_rate": lambda left: learning_rate * left, "batch_size": batch_size, "buffer_size": 2000 * n_rows,
        "learning_starts": 0, "gradient_steps": 1, "policy_kwargs": {"net_arch": [64, 64], **networks},
    }  # fmt: skip


def maximum_entropy(batch_size: int, n_rows: int) -> dict[str, Any]:
    """Return settings of SAC and TQC; the weight of the entropy starts near its final value.

    One critic is enough, because at a discount of 0 no overestimated value enters the targets. The target entropy is
    that of a deviation of 0.3; the default of -1 would be one of 0.09.
    """
    return off_policy(3e-3, batch_size, n_rows, n_critics=1) | {"ent_coef": "auto_0.01", "target_entropy": 0.2}


def td3(n_rows: int) -> dict[str, Any]:
    """Return settings of TD3: noise for exploration, and networks as those of PPO."""
    from stable_baselines3.common.noise import NormalActionNoise
    from torch.nn import Tanh

    noise = {"action_noise": NormalActionNoise(np.zeros(1), np.full(1, 0.2)), "policy_delay": 1}
    return off_policy(2e-3, 2048, n_rows, n_critics=1, activation_fn=Tanh) | noise


SB3, CONTRIB, LEARNED = "stable-baselines3", "sb3-contrib", ("learned",)
LOOPS, BENCHMARL = "docs.studies.library_loops", "docs.studies.library_benchmarl:benchmarl_ppo"
TASK = ("Channels", "ChannelsTask")
LIBRARIES = {
    "sb3-ppo": Library(SB3, partial(sb3, "stable_baselines3:PPO", "MlpPolicy", on_policy), 600_000, 32, LEARNED),
    "sb3-sac": Library(
        SB3, partial(sb3_off_policy, "stable_baselines3:SAC", partial(maximum_entropy, 2048)), 160_000, 16, LEARNED
    ),
    "sb3-td3": Library(SB3, partial(sb3_off_policy, "stable_baselines3:TD3", td3), 100_000, 16, LEARNED),
    "sb3-contrib-tqc": Library(
        CONTRIB, partial(sb3_off_policy, "sb3_contrib:TQC", partial(maximum_entropy, 1024)), 100_000, 16, LEARNED
    ),
    "sb3-contrib-recurrent-ppo": Library(
        CONTRIB, partial(sb3, "sb3_contrib:RecurrentPPO", "MlpLstmPolicy", recurrent), 50_000, 16, LEARNED
    ),
    "torchrl-ppo": Library("torchrl", partial(loop, f"{LOOPS}:torchrl_ppo"), 100_000, 32),
    "skrl-ppo": Library("skrl", partial(loop, f"{LOOPS}:skrl_ppo"), 100_000, 32),
    "cleanrl-ppo": Library("torch", partial(loop, f"{LOOPS}:cleanrl_ppo"), 100_000, 32),
    "rllib-ppo": Library("ray", partial(loop, "docs.studies.library_rllib:rllib_ppo"), 100_000, 32, ("Rows",)),
    "benchmarl-ippo": Library("benchmarl", partial(loop, BENCHMARL, "ippo"), 100_000, 32, TASK),
    "benchmarl-mappo": Library("benchmarl", partial(loop, BENCHMARL, "mappo"), 100_000, 32, TASK),
}


def trained(name: str, on: Setting) -> dict[str, Any]:
    """Train a library and return the record of it, as JSON has it."""
    import torch

    torch.set_num_threads(1)
    library, began_s = LIBRARIES[name], time.process_time()
    j = library.train(on)
    return {
        "library": name,
        "version": versions((library.package,))[library.package],
        **on._asdict(),
        "scenario_hash": scenario_hash(on_test(on.scenario)),
        "cpu_s": round(time.process_time() - began_s, 1),
        "J": [round(cost, 6) for cost in j.tolist()],
    }


def score_of(records: Sequence[dict[str, Any]]) -> Estimate:
    """Score of the trainings of one library on one scenario, with its interval over episodes and, if many, seeds."""
    scenario, episodes = records[0]["scenario"], records[0]["episodes"]
    droop, best = droop_on_test(scenario, episodes).J, hindsight_costs(on_test(scenario), range(episodes))
    scores = [score(record["J"], droop, best).score for record in records]
    if len(scores) == 1:
        return scores[0]
    mean_j = np.mean([record["J"] for record in records], axis=0)
    return mean_over_seeds([each.value for each in scores], score_error(mean_j, droop, best), episodes)


def table(records: Sequence[dict[str, Any]]) -> str:
    """Return a row for each library, scenario, reward and number of steps, as Markdown."""
    heads = ["library", "version", "glue lines", "scenario", "reward", "steps", "seeds", "CPU, s", "score"]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    groups: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for record in records:
        groups.setdefault(tuple(record[name] for name in ("library", "scenario", "reward", "steps")), []).append(record)
    order = list(LIBRARIES)
    for (library, scenario, reward, steps), group in sorted(groups.items(), key=lambda item: order.index(item[0][0])):
        first, cpu_s = group[0], float(np.mean([record["cpu_s"] for record in group]))
        cells = [
            library,
            first["version"],
            LIBRARIES[library].glue_lines,
            f"`{scenario}`",
            reward,
            f"{steps:,}",
        ]
        cells += [len(group), f"{cpu_s:.0f}", estimate(score_of(group), 2)]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def records_in(path: Path) -> list[dict[str, Any]]:
    """Return the records of a file of this study; none if it does not exist. ValueError for another file."""
    if not path.exists():
        return []
    try:
        return json.loads(path.read_text(encoding="utf-8"))["trainings"]
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"out: {path} has no trainings of this study ({error}); choose another --out") from None


@dataclass(frozen=True)
class LibraryTable(Command):
    """Train unmodified libraries and print their table.

    Each training is added to the file, in place of one with other steps or episodes. Finished trainings are skipped.
    The libraries need their packages (docs/rl-libraries.md).
    """

    library: str = ""
    """Library to train, a key of LIBRARIES; none by default, which prints the table of the file."""
    scenarios: str = "ieee33-weak,khodr141,das69,mixed,ieee123-3ph"
    """Names of scenarios (dcgrid list), separated by commas."""
    rewards: str = "difference"
    """Rewards, separated by commas: difference, shared."""
    seeds: int = 5
    """Number of training seeds: 0, 1, .."""
    steps: int | None = None
    """Steps of all environments together, for each training; the library's by default."""
    episodes: int = MOST_EPISODES
    """Test episodes: seeds 0, 1, .."""
    out: Path = DATA
    """File of the trainings."""

    def run(self) -> None:
        """Train and print. ValueError for an invalid setting."""
        at_least(self, seeds=1, episodes=2)
        if self.steps is not None:
            at_least(self, steps=1)
        check_file("out", self.out)
        rewards = split_names(self.rewards)
        if unknown := [reward for reward in rewards if reward not in DISCOUNTS]:
            raise ValueError(f"rewards: {unknown[0]!r} is unknown; choose from {', '.join(DISCOUNTS)}")
        if self.library and self.library not in LIBRARIES:
            raise ValueError(f"library: {self.library!r} is unknown; choose one of {', '.join(LIBRARIES)}")
        if self.library and versions((package := LIBRARIES[self.library].package,))[package] is None:
            raise ValueError(f"library: {self.library} needs {package}, which is not installed; see {PAGE}")
        for on in self._settings(rewards) if self.library else ():
            records = records_in(self.out)
            kept = [one for one in records if not _is_same(one, self.library, on, "scenario", "reward", "seed")]
            if not any(_is_same(one, self.library, on, *on._fields) for one in records):
                write_json(self.out, {"trainings": [*kept, trained(self.library, on)]})
        print(table(records_in(self.out)))

    def _settings(self, rewards: Sequence[str]) -> list[Setting]:
        """Return what to train on, seed after seed."""
        library = LIBRARIES[self.library]
        sizes = (self.steps or library.steps, library.num_envs, self.episodes)
        return [
            Setting(scenario, reward, seed, *sizes)
            for seed in range(self.seeds)
            for scenario in scenario_names(self.scenarios)
            for reward in rewards
        ]


def _is_same(record: dict[str, Any], library: str, on: Setting, *fields: str) -> bool:
    """Return whether a record is of this library and has these fields of a setting."""
    return record["library"] == library and all(record[field] == getattr(on, field) for field in fields)
