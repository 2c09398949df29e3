"""Rounds of the leaderboard: all entries are scored on the same fresh test episodes, and reports state the results.

The seeds of a round follow from one number. It is drawn and published after the round has closed, so no entry can be
fitted to the episodes.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field

from dcgrid_env import Scenario
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.apps.leaderboard.entries import (
    FORMAT,
    REPORT,
    SUBMISSION,
    Submission,
    SubmissionError,
    controller_of,
    policy_sha256,
    read_record,
    require_unchanged,
    scenario_of,
    spec_of,
)
from dcgrid_env.apps.leaderboard.information import measured_information
from dcgrid_env.baselines.evaluation import Evaluation, evaluate
from dcgrid_env.baselines.score import REFERENCE, saved
from dcgrid_env.core.files import sha256_of, write_text
from dcgrid_env.core.versions import PACKAGES, versions

LEAST_EPISODES, MOST_EPISODES = 256, 1024
"""Number of episodes of a round; with 32, J saved by one policy varied from 5.1 to 7.5 % between draws."""
FIRST_SEED = 1_000_000
"""Least seed of a round; published results are for seeds 0, 1, ..."""
TOLERANCE = 1e-4
"""Largest relative difference of a repeated mean cost: other processors round sums of products differently."""
SAVED_TOLERANCE = 1e-3
"""Largest difference of J saved in per cent from the costs of the same report."""
DIGITS = 8
"""Significant digits of the costs in a report."""
Costs = Annotated[
    tuple[Annotated[float, Field(ge=1e-9, le=1e12)], ...], Field(min_length=LEAST_EPISODES, max_length=MOST_EPISODES)
]
"""Cost of each episode."""


@dataclass(frozen=True)
class Report:
    """Results of an entry in a round."""

    __pydantic_config__ = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    format: Literal[3]
    submission: str
    """SHA-256 of submission.json."""
    policy: str
    """``Policy.sha256`` of the policy; empty for a controller without one."""
    scenario_hash: str
    reference: str
    """The tuned droop with its parameters."""
    information: str
    """Information that the controller uses, see ``measured_information``."""
    round_seed: int
    """Number from which the seeds of the episodes follow, see ``round_seeds``."""
    J: Costs
    J_droop: Costs
    """Costs of the tuned droop."""
    saved_pct: tuple[float, float, float]
    """Mean of J_droop - J in per cent of the mean of J_droop, and the bounds of its 95 % interval over episodes."""
    delay_mean_s: float
    droop_delay_mean_s: float
    versions: dict[str, str | None]
    machine: str


def installed() -> dict[str, str | None]:
    """Return the versions of Python and of the packages that results depend on."""
    return {"python": platform.python_version(), **versions(PACKAGES)}


def round_seeds(round_seed: int, episodes: int) -> tuple[int, ...]:
    """Return the seeds of the episodes of a round, from ``FIRST_SEED`` to 2**62.

    Parameters
    ----------
    round_seed
        Published number of the round, at least 0.
    episodes
        Number of episodes. A longer list of the same round begins with the same seeds.
    """
    words = np.random.SeedSequence(round_seed).generate_state(episodes, np.uint64)
    return tuple(FIRST_SEED + int(word) % (2**62 - FIRST_SEED) for word in words)


def verify(
    folder: Path, round_seed: int, episodes: int = LEAST_EPISODES, *, trust: bool = False
) -> tuple[Submission, Report]:
    """Score an entry in a round and write verified.json into its folder.

    Parameters
    ----------
    folder
        Folder that ``submit`` wrote.
    round_seed
        Published number of the round.
    episodes
        Number of episodes, from ``LEAST_EPISODES`` to ``MOST_EPISODES``.
    trust
        Whether code of the submitter may run.

    Raises
    ------
    SubmissionError
        If the number of episodes is outside these limits, or the entry is invalid or has changed since submission.
        ControllerError if the controller fails. An existing verified.json is kept.
    """
    if not LEAST_EPISODES <= episodes <= MOST_EPISODES:
        raise SubmissionError(f"episodes: must be from {LEAST_EPISODES} to {MOST_EPISODES}, got {episodes}")
    submission = read_record(folder / SUBMISSION, Submission)
    require_unchanged(folder, submission)
    spec, scenario, seeds = (
        spec_of(folder, submission, trust),
        scenario_of(submission.scenario),
        round_seeds(round_seed, episodes),
    )
    with on_purpose():
        controller = controller_of(spec, scenario)
        information = measured_information(lambda: controller_of(spec, scenario), scenario, submission.name)
        evaluation = evaluate(controller, scenario, seeds, submission.name)
    droop = droop_on(scenario, seeds)
    costs, droop_costs = _rounded(evaluation.J), _rounded(droop.J)
    report = Report(
        format=FORMAT, submission=sha256_of(folder / SUBMISSION), policy=policy_sha256(controller),
        scenario_hash=submission.scenario_hash, reference=reference(scenario), information=information,
        round_seed=round_seed, J=costs, J_droop=droop_costs, saved_pct=saved(costs, droop_costs),
        delay_mean_s=evaluation.means["delay_mean_s"], droop_delay_mean_s=droop.means["delay_mean_s"],
        versions=installed(), machine=f"{platform.system()} {platform.machine()}",
    )  # fmt: skip
    lines = (f' "{name}": {json.dumps(value, allow_nan=False)}' for name, value in asdict(report).items())
    write_text(folder / REPORT, "{\n" + ",\n".join(lines) + "\n}\n")  # the costs of all episodes on one line
    return submission, report


def verify_again(folder: Path, episodes: int | None = None, *, trust: bool = False) -> tuple[Submission, Report, int]:
    """Repeat the first episodes of an entry's report and compare the costs; write nothing.

    Parameters
    ----------
    folder
        Folder with a report.
    episodes
        Number of episodes to repeat; all of the report by default.
    trust
        Whether code of the submitter may run.

    Returns
    -------
    tuple
        Submission, report and number of repeated episodes.

    Raises
    ------
    SubmissionError
        If ``read_report`` raises it, or a mean cost of the repeated episodes differs by more than ``TOLERANCE``.
    """
    submission, report = read_report(folder)
    if episodes is not None and episodes > len(report.J):
        raise SubmissionError(f"episodes: must be at most {len(report.J)}, those of {folder / REPORT}, got {episodes}")
    spec, scenario = spec_of(folder, submission, trust), scenario_of(submission.scenario)
    n = episodes or len(report.J)
    seeds = round_seeds(report.round_seed, n)
    with on_purpose():
        evaluation = evaluate(controller_of(spec, scenario), scenario, seeds, submission.name)
    for name, expected, costs in (
        ("J", report.J, evaluation.J),
        ("J_droop", report.J_droop, droop_on(scenario, seeds).J),
    ):
        before, again = float(np.mean(expected[:n])), float(np.mean(costs))
        if abs(before - again) > TOLERANCE * abs(again):
            raise SubmissionError(
                f"{folder / REPORT}: the mean of {name} over the first {n} episodes is {before:.6g}, repeated "
                f"{again:.6g}; run dcgrid verify with --round-seed again"
            )
    return submission, report, n


def read_report(folder: Path) -> tuple[Submission, Report]:
    """Read a verified entry; nothing in it runs.

    Parameters
    ----------
    folder
        Folder of the entry.

    Raises
    ------
    SubmissionError
        If a file is missing or invalid, or anything that the report depends on has changed since: the submission, a
        file, the preset, the tuned droop, or the policy that is bundled under the entry's name.
    """
    submission, report, path = (
        read_record(folder / SUBMISSION, Submission),
        read_record(folder / REPORT, Report),
        folder / REPORT,
    )
    require_unchanged(folder, submission)
    spec, scenario = spec_of(folder, submission, trust=True), scenario_of(submission.scenario)
    current = {
        "submission": sha256_of(folder / SUBMISSION), "scenario_hash": submission.scenario_hash,
        "reference": reference(scenario),
        "policy": report.policy if submission.has_code else policy_sha256(controller_of(spec, scenario)),
    }  # fmt: skip
    for name, value in current.items():
        if (reported := getattr(report, name)) != value:
            raise SubmissionError(f"{path}: {name} is {reported!r:.80}, now {value!r:.80}; submit and verify again")
    if len(report.J) != len(report.J_droop):
        raise SubmissionError(f"{path}: J_droop has {len(report.J_droop)} costs, J has {len(report.J)}; verify again")
    value = saved(report.J, report.J_droop)
    if not np.allclose(report.saved_pct, value, rtol=0.0, atol=SAVED_TOLERANCE):
        raise SubmissionError(
            f"{path}: saved_pct is {report.saved_pct}, that of its costs is {tuple(value)}; verify again"
        )
    return submission, report


@lru_cache(maxsize=4)
def droop_on(scenario: Scenario, seeds: tuple[int, ...]) -> Evaluation:
    """Return the results of the tuned droop on episodes."""
    return evaluate(controller_of(REFERENCE, scenario), scenario, seeds, REFERENCE)


@lru_cache
def reference(scenario: Scenario) -> str:
    """Return the tuned droop of a scenario with its parameters, as text."""
    return repr(controller_of(REFERENCE, scenario))


def _rounded(costs: Sequence[float] | np.ndarray) -> tuple[float, ...]:
    return tuple(float(f"{cost:.{DIGITS}g}") for cost in costs)
