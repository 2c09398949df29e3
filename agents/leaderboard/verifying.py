"""Running an entry again: its files, its scenario and episodes, its figures, and fresh episodes beside them."""

from __future__ import annotations

import hashlib
from pathlib import Path

from dcgrid_env import Scenario, scenario_hash
from dcgrid_env.agents.leaderboard.entry_files import (
    CARD,
    CODE,
    CONTROLLER,
    FILE,
    FORMAT,
    NAMED,
    POLICY,
    SCORE_TOLERANCE,
    SUBMISSION,
    VERIFIED,
    Figures,
    Score,
    Submission,
    SubmissionError,
    Verified,
    check_card,
    check_contents,
    plain,
    read,
    sha256_of,
)
from dcgrid_env.agents.leaderboard.running import controller_of, episodes_hash, run, scenario_of, scored, shown
from dcgrid_env.agents.leaderboard.submitting import installed, machine
from dcgrid_env.agents.policy.guard import GuardedPolicy
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.policy.trial_guard import TriedPolicy
from dcgrid_env.baselines import Controller
from dcgrid_env.baselines.registry import CONTROLLER_REGISTRY, split_prefix
from dcgrid_env.core.files import write_json
from dcgrid_env.core.plugins import is_name

TOLERANCE = 1e-4
"""Largest difference between a claimed and a found cost, as a share of it: sums of products are rounded otherwise on
another processor."""
FIRST_FRESH, SPREAD = 1_000, 1_000_000
"""Least seed of fresh episodes, and how many seeds they may begin at."""


def verify(
    folder: Path, *, trust: bool = False, fresh: int = 100, fresh_seed: int | None = None
) -> tuple[Submission, Verified]:
    """Run an entry again and write verified.json into its folder.

    Parameters
    ----------
    folder
        What ``submit`` wrote.
    trust
        Whether code of the submitter's own may run.
    fresh
        Number of further episodes of the test split.
    fresh_seed
        Seed of the first of them; by default one that follows from the hash of submission.json, so that nobody knows
        the episodes before the policy is fixed.

    Raises
    ------
    SubmissionError
        Where a file, the scenario or the episodes are not those that were submitted, or a figure is not found again.
        A verified.json that was there stays.
    """
    submission, claimed = read(folder / SUBMISSION, Submission), folder / SUBMISSION
    controller, scenario = checked(folder, submission, trust)
    first = _fresh_seed(claimed) if fresh_seed is None else fresh_seed
    if fresh < 2 or first < submission.episodes:
        raise SubmissionError(f"fresh is {fresh} from seed {first}; give at least 2 beyond the {submission.episodes}")
    driven = run(controller, scenario, range(submission.episodes), submission.name)
    reached = scored(driven)
    require_found(claimed, submission, driven.figures, reached)
    again = run(controller, scenario, range(first, first + fresh), submission.name)
    record = Verified(
        format=FORMAT, submission=sha256_of(claimed), policy=submission.sha256,
        scenario_hash=submission.scenario_hash, episodes_hash=submission.episodes_hash,
        observes=submission.observes, found=driven.figures, score=reached,
        is_equal_to_the_bit=driven.figures == submission.claimed and reached == submission.score,
        fresh_seed=first, fresh_episodes=fresh, fresh=again.figures,
        versions=installed(), machine=machine(),
    ).sealed()  # fmt: skip
    write_json(folder / VERIFIED, plain(record))
    return submission, record


def checked(folder: Path, submission: Submission, trust: bool) -> tuple[Controller, Scenario]:
    """The controller and the scenario of an entry, all its hashes being right; SubmissionError naming one that is not.

    Code of the submitter's own is imported, and refused without ``trust``.
    """
    claimed = folder / SUBMISSION
    check_contents(folder, submission)
    if submission.kind == CODE and not trust:
        raise SubmissionError(
            f"{claimed}: policy is {submission.policy!r}, code of the submitter's own; verifying runs it: read it, and "
            "add --trust"
        )
    scenario = scenario_of(submission.scenario)
    if (own := scenario_hash(scenario)) != submission.scenario_hash:
        raise SubmissionError(
            f"{claimed}: scenario_hash is {submission.scenario_hash}, that of {scenario.name} is {own} here; verify "
            f"with dcgrid-env {submission.versions.get('dcgrid-env')}, or submit again"
        )
    if (own := episodes_hash(scenario, submission.episodes)) != submission.episodes_hash:
        raise SubmissionError(
            f"{claimed}: episodes_hash is {submission.episodes_hash[:16]}.., that of the test seeds 0 to "
            f"{submission.episodes - 1} is {own[:16]}..; submit again"
        )
    controller = controller_of(_spec(folder, submission), scenario)
    inner = controller.policy if isinstance(controller, GuardedPolicy | TriedPolicy) else controller
    if isinstance(inner, Policy) and inner.sha256 != submission.sha256:
        raise SubmissionError(
            f"{claimed}: sha256 is {submission.sha256[:16]}.., that of the policy {submission.policy} is "
            f"{inner.sha256[:16]}..; submit again"
        )
    if submission.kind == FILE:
        check_card(folder / CARD, submission)
    if (own := shown(controller, scenario)) != submission.observes:
        raise SubmissionError(
            f"{claimed}: observes is {submission.observes!r}, the controller's is {own!r}; submit again"
        )
    return controller, scenario


def _spec(folder: Path, submission: Submission) -> str:
    """What names an entry's controller here; SubmissionError for what could run code under another kind's name."""
    before, inner = split_prefix(submission.policy)
    if submission.kind == NAMED:
        fits = inner in CONTROLLER_REGISTRY and CONTROLLER_REGISTRY.origin(inner) is None and is_name(inner)
    else:
        file = inner.partition(":")[0]
        fits = file in submission.files and (file, submission.kind) == (
            (POLICY, FILE) if file == inner else (CONTROLLER, CODE)
        )
    if not fits:
        raise SubmissionError(
            f"{folder / SUBMISSION}: policy is {submission.policy!r}, which is none of kind {submission.kind}; "
            "submit it again"
        )
    return submission.policy if submission.kind == NAMED else f"{before}{folder / inner}"


def _fresh_seed(claimed: Path) -> int:
    digest = hashlib.sha256(claimed.read_bytes()).digest()
    return FIRST_FRESH + int.from_bytes(digest[:8], "big") % SPREAD


def require_found(claimed: Path, submission: Submission, found: Figures, reached: Score) -> None:
    """SubmissionError, naming the first figure that is not found again within the tolerances."""
    for name in ("J", "J_droop"):
        one, other = getattr(submission.claimed, name), getattr(found, name)
        if abs(one - other) > TOLERANCE * abs(other):
            raise SubmissionError(
                f"{claimed}: claimed.{name} is {one:.6g}, found {other:.6g}, more than {TOLERANCE:g} of it "
                "apart; submit what this version reaches"
            )
    figures = [(f"score.{name}", one, getattr(reached, name)) for name, one in submission.score._asdict().items()]
    figures += [
        (f"claimed.{name}", getattr(submission.claimed, name), getattr(found, name))
        for name in ("delay_mean_s", "droop_delay_mean_s")
    ]
    figures += [("claimed.gain", *pair) for pair in zip(submission.claimed.gain, found.gain, strict=True)]
    for name, one, other in figures:
        if abs(one - other) > SCORE_TOLERANCE * max(1.0, abs(other)):
            raise SubmissionError(
                f"{claimed}: {name} is {one:.6g}, found {other:.6g}, which differ by more than {SCORE_TOLERANCE:g}; "
                "submit what this version reaches"
            )
