"""Verification of entries: their files, scenario and figures, and fresh episodes."""

from __future__ import annotations

import secrets
from dataclasses import replace
from pathlib import Path

from dcgrid_env import Scenario, scenario_hash
from dcgrid_env.agents.leaderboard.confinement import readable, version
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
)
from dcgrid_env.agents.leaderboard.remote import import_path, require_system
from dcgrid_env.agents.leaderboard.running import Runner, episodes_hash, reference, run, scenario_of, scored
from dcgrid_env.agents.leaderboard.signing import KEY_VARIABLE, is_signed, private_key, private_key_file, sign
from dcgrid_env.agents.leaderboard.submitting import installed, machine, runner_of
from dcgrid_env.baselines.registry import CONTROLLER_REGISTRY, split_prefix
from dcgrid_env.core.files import sha256_of, write_json
from dcgrid_env.core.plugins import is_name

TOLERANCE = 1e-4
"""Largest difference between a claimed and a found cost, as a share of it: sums of products are rounded otherwise on
another processor."""
FIRST_FRESH, SEEDS = 1_000, 2**62
"""Least seed of fresh episodes, and how many seeds they may begin at: too many to try them all."""


def draw_seed() -> int:
    """Seed of the first fresh episode, from the system's entropy."""
    return FIRST_FRESH + secrets.randbelow(SEEDS)


def verify(
    folder: Path, seed: int | None = None, *, trust: bool = False, fresh: int = 100
) -> tuple[Submission, Verified]:
    """Run an entry again and write verified.json into its folder, signed where the verifier's key is there.

    Parameters
    ----------
    folder
        What ``submit`` wrote.
    seed
        Seed of the first fresh episode; by default drawn now; for several folders, the one of ``draw_seed``.
    trust
        Whether the submitter's code may run.
    fresh
        Number of fresh episodes of the test split.

    Raises
    ------
    SubmissionError
        Where a file, the scenario or the episodes are not those that were submitted, or a figure is not found again.
        A verified.json that was there stays.
    """
    require_system()
    if fresh < 2:
        raise SubmissionError(f"fresh is {fresh}; give at least 2")
    private_key()  # one that does not fit is refused before the episodes are run
    submission = read(folder / SUBMISSION, Submission)
    runner, scenario = checked(folder, submission, trust)
    record = _report(folder, submission, runner, scenario, draw_seed() if seed is None else seed, fresh)
    record = replace(record, signature=sign(record.signed_content))
    write_json(folder / VERIFIED, plain(record))
    return submission, record


def verify_again(folder: Path, *, trust: bool = False) -> tuple[Submission, Verified, bool]:
    """Run an entry on the seeds of its report, and compare; nothing is written.

    Returns
    -------
    tuple
        Submission and report, and whether all figures are those of the report to the last bit.

    Raises
    ------
    SubmissionError
        Where ``verify`` raises it, and where a figure of the report is not found again.
    """
    require_system()
    submission, before = read(folder / SUBMISSION, Submission), read(folder / VERIFIED, Verified)
    require_report(folder, before)
    runner, scenario = checked(folder, submission, trust)
    again = _report(folder, submission, runner, scenario, before.fresh_seed, before.fresh_episodes)
    path, figures = folder / VERIFIED, ("found", "score", "fresh")
    require_found(path, "found", before.found, before.score, again.found, again.score)
    require_found(path, "fresh", before.fresh, before.score, again.fresh, again.score)
    return submission, before, all(getattr(before, name) == getattr(again, name) for name in figures)


def require_report(folder: Path, report: Verified) -> None:
    """SubmissionError unless a report is of a folder's submission and signed by the verifier."""
    path = folder / VERIFIED
    if report.submission != sha256_of(folder / SUBMISSION):
        raise SubmissionError(f"{path}: submission is of another {SUBMISSION}; the verifier must run dcgrid verify")
    if not is_signed(report.signed_content, report.signature):
        raise SubmissionError(f"{path}: signature is not the verifier's; the verifier must run dcgrid verify {folder}")


def _report(
    folder: Path, submission: Submission, runner: Runner, scenario: Scenario, first: int, fresh: int
) -> Verified:
    """Run an entry; SubmissionError where the claims are not found."""
    published, new = run(runner, scenario, [range(submission.episodes), range(first, first + fresh)], submission.name)
    reached = scored(published)
    require_found(folder / SUBMISSION, "claimed", submission.claimed, submission.score, published.figures, reached)
    return Verified(
        format=FORMAT, submission=sha256_of(folder / SUBMISSION), policy=submission.sha256,
        scenario_hash=submission.scenario_hash, episodes_hash=submission.episodes_hash,
        reference=reference(scenario), scope=submission.scope,
        found=published.figures, score=reached, fresh_seed=first, fresh_episodes=fresh, fresh=new.figures,
        versions=installed(), machine=machine(),
    )  # fmt: skip


def checked(folder: Path, submission: Submission, trust: bool) -> tuple[Runner, Scenario]:
    """What is run of an entry and the scenario, all its hashes being right; SubmissionError naming one that is not.

    Code of a submitter is refused without ``trust`` and where it cannot be confined. It does not run in this process.
    """
    claimed = folder / SUBMISSION
    check_contents(folder, submission)
    if submission.kind == CODE and not trust:
        raise SubmissionError(
            f"{claimed}: policy is {submission.policy!r}, code of the submitter; verifying runs it: read it, and "
            "add --trust"
        )
    if submission.kind == CODE and not version():
        raise SubmissionError(
            f"{claimed}: policy is {submission.policy!r}, code, which this system cannot confine; verify on Linux 5.13 "
            "or newer with Landlock"
        )
    if submission.kind == CODE:
        _require_hidden(private_key_file())
    scenario = scenario_of(submission.scenario)
    if (found := scenario_hash(scenario)) != submission.scenario_hash:
        raise SubmissionError(
            f"{claimed}: scenario_hash is {submission.scenario_hash}, that of {scenario.name} is {found} here; verify "
            f"with dcgrid-env {submission.versions.get('dcgrid-env')}, or submit again"
        )
    if (found := episodes_hash(scenario, submission.episodes)) != submission.episodes_hash:
        raise SubmissionError(
            f"{claimed}: episodes_hash is {submission.episodes_hash[:16]}.., that of the test seeds 0 to "
            f"{submission.episodes - 1} is {found[:16]}..; submit again"
        )
    code = folder / CONTROLLER if submission.kind == CODE else None
    runner, policy = runner_of(_spec(folder, submission), scenario, submission.scope, code, confined=True)
    if policy is not None and policy.sha256 != submission.sha256:
        raise SubmissionError(
            f"{claimed}: sha256 is {submission.sha256[:16]}.., that of the policy {submission.policy} is "
            f"{policy.sha256[:16]}..; submit again"
        )
    if submission.kind == FILE:
        check_card(folder / CARD, submission)
    if (measured := str(runner.scope)) != submission.scope:
        raise SubmissionError(f"{claimed}: scope is {submission.scope!r}, found {measured!r}; submit again")
    return runner, scenario


def _require_hidden(key: Path) -> None:
    """SubmissionError if confined code could read the verifier's key."""
    for path in readable(import_path()):
        if key.resolve().is_relative_to(path.resolve()):
            raise SubmissionError(
                f"{key}: is below {path}, which code of a submitter can read; move it, and set {KEY_VARIABLE}"
            )


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


def require_found(path: Path, part: str, expected: Figures, score: Score, found: Figures, reached: Score) -> None:
    """SubmissionError, naming the first figure of a part of a file that is not found again within the tolerances."""
    for name in ("J", "J_droop"):
        one, other = getattr(expected, name), getattr(found, name)
        if abs(one - other) > TOLERANCE * abs(other):
            raise SubmissionError(
                f"{path}: {part}.{name} is {one:.6g}, found {other:.6g}, more than {TOLERANCE:g} of it apart; submit "
                "what this version reaches"
            )
    figures = [(f"score.{name}", one, getattr(reached, name)) for name, one in score._asdict().items()]
    figures += [
        (f"{part}.{name}", getattr(expected, name), getattr(found, name))
        for name in ("delay_mean_s", "droop_delay_mean_s")
    ]
    figures += [(f"{part}.gain", *pair) for pair in zip(expected.gain, found.gain, strict=True)]
    for name, one, other in figures:
        if abs(one - other) > SCORE_TOLERANCE * max(1.0, abs(other)):
            raise SubmissionError(
                f"{path}: {name} is {one:.6g}, found {other:.6g}, which differ by more than {SCORE_TOLERANCE:g}; "
                "submit what this version reaches"
            )
