"""Train unmodified reinforcement-learning libraries on presets, and score them on the test episodes."""

from __future__ import annotations

import ast
import gc
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dcgrid_env import scenario_hash
from dcgrid_env.agents import ppo_settings, sac_settings, sb3_vec_env, td3_settings
from dcgrid_env.baselines.evaluation import hindsight_costs
from dcgrid_env.baselines.scenario_names import scenario_names
from dcgrid_env.baselines.score import Estimate, mean_over_seeds, score, score_error
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.names import split_names
from dcgrid_env.core.commands.settings import at_least, check_file
from dcgrid_env.core.files import write_json
from dcgrid_env.core.versions import versions
from dcgrid_env.traces.timing import peak_mib
from docs.studies.learning.learning_tables import estimate
from docs.studies.learning.library_batches import DISCOUNTS, OFF_POLICY_BATCH, BestOnValidation, Outcome, Setting
from docs.studies.learning.scored import droop_on_test, on_test

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecEnv

DATA, PAGE = Path("docs/rl-libraries.json"), Path("docs/rl-libraries.md")
CLEAR_PEAK = Path("/proc/self/clear_refs")
MOST_EPISODES = 32
"""Test episodes whose hindsight is published for every preset."""


def sb3(
    model_class: str, settings: Callable[[VecEnv, int], dict[str, Any]], on: Setting, *, scales_rewards: bool = False
) -> Outcome:
    """Train an algorithm of Stable-Baselines3 or sb3-contrib, whose VecNormalize may scale the rewards."""
    made = sb3_vec_env(on.scenario, on.num_envs, reward=on.reward)
    arguments, envs = settings(made, on.steps), made
    if scales_rewards:
        from stable_baselines3.common.vec_env import VecNormalize

        envs = VecNormalize(made, norm_obs=False, gamma=arguments["gamma"])
    model = resolve_name(model_class)(env=envs, seed=on.seed, **arguments)
    best, steps = BestOnValidation(model.policy, partial(predicted, model), on), on.steps * made.rows_per_env

    def on_step(found: dict[str, Any], _: Any) -> bool:
        best.evaluate(found["self"].num_timesteps / steps)
        return True

    model.learn(steps, on_step)
    return best.tested()


def predicted(model: BaseAlgorithm) -> Callable[[np.ndarray], np.ndarray]:
    """Return the mean actions of a model for rows, from the first step of an episode on; it may be recurrent."""
    state: Any = None

    def act(rows: np.ndarray) -> np.ndarray:
        nonlocal state
        first = np.full(len(rows), state is None)
        actions, state = model.predict(rows, state, episode_start=first, deterministic=True)
        return actions

    return act


def loop(function: str, *arguments: Any) -> Outcome:
    """Train by a function, "module:name", whose module needs an optional library."""
    return resolve_name(function)(*arguments)


class Library(NamedTuple):
    """A library's algorithm with its settings."""

    package: str
    """Distribution whose version is stored."""
    train: Callable[[Setting], Outcome]
    """Function that trains, and tests the policy that is best on validation."""
    steps: int
    """Default of ``Setting.steps``."""
    num_envs: int

    glue: tuple[str, ...] = ()
    """Further functions and classes that connect the library: names in the same module, or "module:name"."""

    @property
    def glue_lines(self) -> int:
        """Lines of code that connect the library: its function and ``glue``, without docstrings."""
        train: Any = self.train
        place = train.args[0] if train.func is loop else f"{train.func.__module__}:{train.func.__name__}"
        module = place.split(":")[0]
        places = (place, *(name if ":" in name else f"{module}:{name}" for name in self.glue))
        return sum(code_lines(*each.split(":")) for each in places)


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


def recurrent(envs: VecEnv, steps: int) -> dict[str, Any]:
    """Return settings of PPO with small recurrent networks."""
    settings = ppo_settings(envs, steps)
    settings["policy_kwargs"] |= {"lstm_hidden_size": 32, "net_arch": [64]}
    return settings | {"policy": "MlpLstmPolicy"}


def tqc(envs: VecEnv, _: int) -> dict[str, Any]:
    """Return settings of TQC: those of SAC with smaller batches."""
    return sac_settings(envs) | {"batch_size": 1024}


def sac(envs: VecEnv, _: int) -> dict[str, Any]:
    """Return settings of SAC with small batches."""
    return sac_settings(envs) | {"batch_size": OFF_POLICY_BATCH}


def td3(envs: VecEnv, _: int) -> dict[str, Any]:
    """Return settings of TD3 with small batches."""
    return td3_settings(envs) | {"batch_size": OFF_POLICY_BATCH}


SB3, CONTRIB, PREDICTED = "stable-baselines3", "sb3-contrib", ("predicted",)
LOOPS, BENCHMARL = "docs.studies.learning.library_loops", "docs.studies.learning.library_benchmarl:benchmarl"
ROWS = (f"{LOOPS}:train_rows", f"{LOOPS}:best_mean")
TASK = (*ROWS, "Channels", "ChannelsTask")
LIBRARIES = {
    "sb3-ppo": Library(SB3, partial(sb3, "stable_baselines3:PPO", ppo_settings), 600_000, 32, PREDICTED),
    "sb3-sac": Library(SB3, partial(sb3, "stable_baselines3:SAC", sac), 20_000, 8, PREDICTED),
    "sb3-td3": Library(SB3, partial(sb3, "stable_baselines3:TD3", td3, scales_rewards=True), 20_000, 8, PREDICTED),
    "sb3-contrib-tqc": Library(CONTRIB, partial(sb3, "sb3_contrib:TQC", tqc), 100_000, 16, PREDICTED),
    "sb3-contrib-recurrent-ppo": Library(
        CONTRIB, partial(sb3, "sb3_contrib:RecurrentPPO", recurrent), 50_000, 16, PREDICTED
    ),
    "torchrl-ppo": Library("torchrl", partial(loop, f"{LOOPS}:torchrl_ppo"), 100_000, 32, ROWS),
    "skrl-ppo": Library("skrl", partial(loop, f"{LOOPS}:skrl_ppo"), 100_000, 32, ROWS),
    "cleanrl-ppo": Library(
        "torch", partial(loop, f"{LOOPS}:cleanrl_ppo"), 100_000, 32, (*ROWS, "docs.examples.cleanrl_ppo:train")
    ),
    "rllib-ppo": Library("ray", partial(loop, "docs.studies.learning.library_rllib:rllib_ppo"), 100_000, 32, ROWS),
    "benchmarl-ippo": Library("benchmarl", partial(loop, BENCHMARL, "ippo"), 100_000, 32, (*TASK, "on_policy")),
    "benchmarl-mappo": Library("benchmarl", partial(loop, BENCHMARL, "mappo"), 100_000, 32, (*TASK, "on_policy")),
    "benchmarl-maddpg": Library("benchmarl", partial(loop, BENCHMARL, "maddpg"), 20_000, 16, (*TASK, "off_policy")),
}


def trained(name: str, on: Setting) -> dict[str, Any]:
    """Train a library and return the record of it, as JSON has it."""
    import torch

    torch.set_num_threads(1)
    forget_peak_memory()
    library, began_s = LIBRARIES[name], time.process_time()
    tested = library.train(on)
    return {
        "library": name,
        "version": versions((library.package,))[library.package],
        **on._asdict(),
        "scenario_hash": scenario_hash(on_test(on.scenario)),
        "cpu_s": round(time.process_time() - began_s, 1),
        "peak_mib": round(peak_mib()),
        "J_validation": round(tested.validation, 6),
        "J": [round(cost, 6) for cost in tested.J.tolist()],
    }


def forget_peak_memory() -> None:
    """Let the peak memory of this process begin at the present one, where the system has this (Linux)."""
    gc.collect()
    if CLEAR_PEAK.exists():
        CLEAR_PEAK.write_text("5", encoding="utf-8")


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
    After a training that fails the others go on. The libraries need their packages (docs/rl-libraries.md).
    """

    library: str = ""
    """Libraries to train, separated by commas, of LIBRARIES; none by default, which prints the table of the file."""
    scenarios: str = "ieee33-weak,khodr141,das69,mixed,ieee123-3ph"
    """Names of scenarios (dcgrid list), separated by commas."""
    rewards: str = "difference"
    """Rewards, separated by commas: difference, local, shared."""
    seeds: int = 5
    """Number of training seeds: 0, 1, .."""
    steps: int | None = None
    """Decisions in all environments together, for each training; the library's by default."""
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
        libraries = split_names(self.library)
        for name in libraries:
            if name not in LIBRARIES:
                raise ValueError(f"library: {name!r} is unknown; choose from {', '.join(LIBRARIES)}")
            if versions((package := LIBRARIES[name].package,))[package] is None:
                raise ValueError(f"library: {name} needs {package}, which is not installed; see {PAGE}")
        failed = [name for name, on in self._settings(libraries, rewards) if not self._is_done(name, on)]
        print(table(records_in(self.out)))
        if failed:
            raise ValueError(f"library: {len(failed)} trainings failed, see above: {', '.join(sorted(set(failed)))}")

    def _settings(self, libraries: Sequence[str], rewards: Sequence[str]) -> list[tuple[str, Setting]]:
        """Return what to train and on what, seed after seed."""
        return [
            (name, Setting(scenario, reward, seed, self.steps or library.steps, library.num_envs, self.episodes))
            for seed in range(self.seeds)
            for scenario in (scenario_names(self.scenarios) if libraries else ())
            for name, library in ((name, LIBRARIES[name]) for name in libraries)
            for reward in rewards
        ]

    def _is_done(self, name: str, on: Setting) -> bool:
        """Train and add the record to the file, unless it is there; print why a training fails and return False."""
        records = records_in(self.out)
        if any(_is_same(one, name, on, *on._fields) for one in records):
            return True
        try:
            record = trained(name, on)
        except Exception as error:  # a library may raise anything
            print(f"{name} on {on.scenario}, {on.reward}, seed {on.seed}: {error!r}", file=sys.stderr)
            return False
        kept = [one for one in records if not _is_same(one, name, on, "scenario", "reward", "seed")]
        write_json(self.out, {"trainings": [*kept, record]})
        return True


def _is_same(record: dict[str, Any], library: str, on: Setting, *fields: str) -> bool:
    """Return whether a record is of this library and has these fields of a setting."""
    return record["library"] == library and all(record[field] == getattr(on, field) for field in fields)
