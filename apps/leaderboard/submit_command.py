"""The command ``dcgrid submit``: from a controller to the folder of an entry."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import tyro

from dcgrid_env import Scenario, scenario_hash
from dcgrid_env.agents.controllers import trained_on
from dcgrid_env.agents.from_sb3.sb3_policy import convert
from dcgrid_env.agents.from_sb3.sb3_zip import SUFFIX as ZIP
from dcgrid_env.agents.policy.policy_file import SUFFIX
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.apps.leaderboard.entries import (
    CARD,
    CODE,
    FORMAT,
    LONGEST_POLICY,
    POLICY,
    SUBMISSION,
    Learned,
    Submission,
    SubmissionError,
    controller_of,
    is_bundled,
    require_lines,
    scenario_of,
)
from dcgrid_env.apps.leaderboard.rounds import droop_on, installed
from dcgrid_env.baselines.evaluation import Evaluation, below_static, evaluate
from dcgrid_env.baselines.file_names import file_name
from dcgrid_env.baselines.registry import CONTROLLER_REGISTRY, controller_file, require_known, split_prefix
from dcgrid_env.baselines.score import static_rules
from dcgrid_env.baselines.user_code import parse
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.terminal import plain_console, say, working
from dcgrid_env.core.files import sha256_of, whole_folder, write_bytes, write_json


@dataclass(frozen=True)
class Submit(Command):
    """Create an entry for the leaderboard.

    An entry is a folder with the policy, hashes of its files and of the scenario, and package versions. The command
    also prints the score on published test episodes. dcgrid verify scores entries on the new episodes of a round.
    """

    policy: tyro.conf.Positional[str]
    """Policy: a policy file, a Stable-Baselines3 model (.zip), a training run's folder, a bundled policy or controller
    (dcgrid list), a bundled law with arguments ("dcgrid_env.baselines:Droop(k_p_mw_per_pu=2)"), or your class
    (file.py:Class, quoted if it takes arguments). For your class, only its file is copied."""
    name: str
    """Name of the entry on the leaderboard."""
    paper: str = ""
    """Reference for the policy: a link or a line of text."""
    scenario: str | None = None
    """Preset to score on. Default: the preset that the policy was trained on."""
    episodes: int = 100
    """Number of published test episodes for the printed score, with seeds 0, 1, ..."""
    learned_on: Learned = "train"
    """Your declaration of the split used to train, tune or select the policy. Here train includes validation."""
    out: Path | None = None
    """Folder to create. Default: a folder in results/submissions, named after --scenario and --name."""

    def run(self) -> None:
        """Run, write and print; raise ValueError before writing if the policy cannot be an entry."""
        out = self.out or Path("results/submissions") / file_name("-".join(filter(None, (self.scenario, self.name))))
        console = plain_console()
        with working(console, f"{self.episodes} episodes"):
            entry, evaluation = submit(
                self.policy, self.name, out, paper=self.paper, scenario=self.scenario, episodes=self.episodes,
                learned_on=self.learned_on,
            )  # fmt: skip
            scored = evaluation.score(droop_on(evaluation.scenario, evaluation.seeds))
            rules = _static_evaluations(evaluation.scenario, evaluation.seeds)
        value, low, high = scored.score
        say(
            console,
            f"{entry.name} on {entry.scenario}: J {evaluation.means['J']:.4f}, score {value:.3f} "
            f"({low:.3f} .. {high:.3f}) on {self.episodes} published episodes",
        )
        if line := below_static(entry.name, evaluation.means, rules):
            say(console, line)
        say(console, f"wrote {out}; next: dcgrid verify {out} --round-seed 1")


def submit(
    policy: str, name: str, out: Path, *, paper: str = "", scenario: str | None = None, episodes: int = 100,
    learned_on: Learned = "train",
) -> tuple[Submission, Evaluation]:  # fmt: skip
    """Run a controller on published test episodes of a preset, and write the folder of an entry.

    Parameters
    ----------
    policy
        Name of the controller, see ``find_controller``. A model of Stable-Baselines3 becomes a policy file.
    name, paper
        Name of the entry on the page, and a reference.
    out
        Folder to create.
    scenario
        Preset on whose test split it is scored; by default the one that the policy was trained on.
    episodes
        Number of published episodes, with seeds 0, 1, ..
    learned_on
        Declaration of the split on which the controller was trained or tuned.

    Returns
    -------
    tuple
        The submission, and its results on the published episodes.

    Raises
    ------
    ValueError
        If the entry is invalid, or the controller cannot be scored. Nothing is written then.
    """
    require_lines(name=name, paper=paper)
    before, inner = split_prefix(policy)
    file = controller_file(inner)
    if file is not None and file.suffix == ZIP:
        with TemporaryDirectory() as folder:
            policy_file = convert(file, Path(folder) / POLICY)
            return submit(
                f"{before}{policy_file}", name, out, paper=paper, scenario=scenario, episodes=episodes,
                learned_on=learned_on,
            )  # fmt: skip
    text, files = _in_folder(policy)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise SubmissionError(f"out is {str(out)!r}, which is there and not empty; choose another folder")
    test = scenario_of(scenario or _trained_preset(policy))
    with on_purpose():
        evaluation = evaluate(controller_of(policy, test), test, range(episodes), name)
    evaluation.score(droop_on(test, evaluation.seeds))
    submission = Submission(
        format=FORMAT, name=name, paper=paper, policy=text,
        files={target: sha256_of(path) for target, path in files.items()}, scenario=test.name,
        scenario_hash=scenario_hash(test), learned_on=learned_on, versions=installed(),
    )  # fmt: skip
    with whole_folder(out) as folder:
        for target, path in files.items():
            write_bytes(folder / target, path.read_bytes())
        write_json(folder / SUBMISSION, asdict(submission))
    return submission, evaluation


def _in_folder(policy: str) -> tuple[str, dict[str, Path]]:
    """Text and files of a controller in the folder of an entry; SubmissionError if an entry cannot have it."""
    if len(policy) > LONGEST_POLICY:
        raise SubmissionError(f"policy has {len(policy)} letters; give at most {LONGEST_POLICY}")
    before, inner = split_prefix(policy)
    if is_bundled(inner):
        return policy, {}
    reference = parse(inner)
    if reference is not None:
        if reference.path is None:
            raise SubmissionError(f"policy is {policy!r}; give path/to/file.py:Class, whose file goes into the folder")
        if not reference.path.is_file():
            raise SubmissionError(f"policy is {policy!r}; there is no file {reference.where}")
        return f"{before}{CODE}{inner.strip()[len(reference.where) :]}", {CODE: reference.path}
    weights = controller_file(inner)
    if weights is not None and weights.suffix == SUFFIX:
        card = weights.with_suffix(".json")
        for needed in (weights, card):
            if not needed.is_file():
                raise SubmissionError(f"policy is {policy!r}; there is no file {needed} (Policy.save writes both)")
        return f"{before}{POLICY}", {POLICY: weights, CARD: card}
    require_known(inner)
    raise SubmissionError(
        f"policy is {policy!r}, which comes from {CONTROLLER_REGISTRY.origin(inner)}; give the file of its class"
    )


def _trained_preset(policy: str) -> str:
    """Return the preset that a policy was trained on; raise SubmissionError if there is none."""
    if where := trained_on(policy):
        return where.partition(" --set ")[0]
    raise SubmissionError(f"policy {policy!r} was not trained on a preset; pass --scenario (dcgrid list)")


def _static_evaluations(scenario: Scenario, seeds: tuple[int, ...]) -> dict[str, Evaluation]:
    """Results of the rules without measurements that have tuned parameters for a scenario, by name."""
    evaluations = {}
    for name in static_rules(scenario):
        with suppress(ValueError):
            evaluations[name] = evaluate(controller_of(name, scenario), scenario, seeds, name)
    return evaluations
