"""Entries of the leaderboard: folders that name a controller and the preset on which it is scored.

``submission.json`` describes an entry. A learned policy is a file next to it; a controller of this package needs no
file. Both are data. An entry with code has ``controller.py``, which runs only where ``trust`` is set.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from inspect import isclass
from pathlib import Path
from typing import Literal, TypeVar

from pydantic import ConfigDict, TypeAdapter, ValidationError

import dcgrid_env.baselines as baselines
from dcgrid_env import PRESETS, Scenario, scenario_hash
from dcgrid_env.agents.policy.guard import GuardedPolicy
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.policy.policy_file import MOST_MIB
from dcgrid_env.agents.policy.trial_guard import TriedPolicy
from dcgrid_env.baselines import Controller, find_controller
from dcgrid_env.baselines.registry import CONTROLLER_REGISTRY, split_prefix
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.baselines.score import SPLIT
from dcgrid_env.baselines.user_code import parse
from dcgrid_env.core.files import sha256_of
from dcgrid_env.core.plugins import is_name
from dcgrid_env.core.user_files import is_file, read_bytes

SUBMISSION, REPORT = "submission.json", "verified.json"
FORMAT = 3
"""Format version of both files."""
POLICY, CARD, CODE = "policy.safetensors", "policy.json", "controller.py"
"""File names in the folder of an entry."""
LONGEST = 80
"""Maximum length of a name or a reference, in characters."""
LONGEST_POLICY = 300
"""Maximum length of the text that names a controller, in characters."""
MOST_RECORD_MIB = 1
"""Maximum size of submission.json and verified.json."""
Learned = Literal["train", "validation", "test", "nothing"]
"""Split on which an entry was trained or tuned."""
TUNED = Path(str(files("dcgrid_env.baselines.data") / "tuned.json"))
"""Parameters of tuned controllers: the bundled ones, independent of the working directory."""
T = TypeVar("T")


class SubmissionError(ValueError):
    """Report an invalid or changed entry; the message names file, field, value and remedy."""


@dataclass(frozen=True)
class Submission:
    """A controller that enters the leaderboard of a preset."""

    __pydantic_config__ = ConfigDict(extra="forbid", strict=True)

    format: Literal[3]
    name: str
    """Name of the entry on the leaderboard page."""
    paper: str
    """Reference to a description of the controller."""
    policy: str
    """A name of ``dcgrid list``, a law with arguments (``dcgrid_env.baselines:Droop(k_p_mw_per_pu=2)``),
    ``policy.safetensors``, or class and arguments in ``controller.py``."""
    files: dict[str, str]
    """SHA-256 of each file of the entry, by name."""
    scenario: str
    """Name of the preset."""
    scenario_hash: str
    """Hash of the preset on its test split."""
    learned_on: Learned
    """Split on which the controller was trained or tuned, as declared by the submitter."""
    versions: dict[str, str | None]
    """Versions of Python and packages on the submitter's machine."""

    @property
    def has_code(self) -> bool:
        """Whether the entry has code of the submitter."""
        return CODE in self.files


def read_record(path: Path, kind: type[T]) -> T:
    """Read submission.json or verified.json.

    Parameters
    ----------
    path
        The file, of at most 1 MiB.
    kind
        Dataclass of its content.

    Raises
    ------
    SubmissionError
        If the file is missing or invalid; the message names the file and the first wrong field.
    """
    if not is_file(path, SubmissionError):
        remedy = {SUBMISSION: "give a folder that dcgrid submit wrote", REPORT: "run dcgrid verify on the folder"}
        raise SubmissionError(f"{path}: there is no such file; {remedy[path.name]}")
    try:
        return TypeAdapter(kind).validate_json(read_bytes(path, SubmissionError, MOST_RECORD_MIB))
    except ValidationError as error:
        errors = error.errors(include_url=False, include_input=False)
        first = next((one for one in errors if one["loc"] == ("format",)), errors[0])  # explains all others
        field = ascii(".".join(map(str, first["loc"])))[1:-1][:LONGEST] or "content"
        raise SubmissionError(f"{path}: {field}: {first['msg'].lower()}; submit and verify again") from None


def require_lines(**texts: str) -> None:
    """Raise SubmissionError if a text of the submitter does not fit into a table cell, or the name is empty."""
    for field, text in texts.items():
        if len(text) > LONGEST or not text.isprintable() or (field == "name" and not text.strip()):
            raise SubmissionError(f"{field} is {text[:LONGEST]!r}; give one line of 1 to {LONGEST} letters")


def scenario_of(name: str) -> Scenario:
    """Return a preset on its test split; raise SubmissionError for another name."""
    if name not in PRESETS:
        raise SubmissionError(f"scenario is {name[:LONGEST]!r}; the leaderboard has the presets: {', '.join(PRESETS)}")
    return ScenarioSpec(name).make(SPLIT)


def controller_of(spec: str, scenario: Scenario) -> Controller:
    """Return a new controller with bundled parameters; raise ValueError if ``spec`` names none."""
    return find_controller(spec, scenario, TUNED)


def policy_sha256(controller: Controller) -> str:
    """Return ``Policy.sha256`` of the policy that a controller uses; an empty text if it uses none."""
    policy = controller.policy if isinstance(controller, GuardedPolicy | TriedPolicy) else controller
    return policy.sha256 if isinstance(policy, Policy) else ""


def is_bundled(spec: str) -> bool:
    """Return whether a text without prefix names a controller of this package, or a law of it with its arguments."""
    if spec in CONTROLLER_REGISTRY:
        return is_name(spec) and CONTROLLER_REGISTRY.origin(spec) is None
    law = parse(spec)
    return law is not None and law.where == baselines.__name__ and law.name in _laws()


@cache
def _laws() -> frozenset[str]:
    """Names of the classes in ``dcgrid_env.baselines.laws`` that ``dcgrid_env.baselines`` exports."""
    public = {name: getattr(baselines, name) for name in baselines.__all__}
    room = f"{baselines.__name__}.laws."
    return frozenset(name for name, one in public.items() if isclass(one) and one.__module__.startswith(room))


def require_unchanged(folder: Path, submission: Submission) -> None:
    """Raise SubmissionError if an entry is invalid or differs from what was submitted; nothing in it runs.

    Parameters
    ----------
    folder
        Folder of the entry.
    submission
        Content of its submission.json.
    """
    path = folder / SUBMISSION
    try:
        require_lines(name=submission.name, paper=submission.paper)
        scenario = scenario_of(submission.scenario)
        fits = len(submission.policy) <= LONGEST_POLICY and _fits(submission)
    except ValueError as error:
        raise SubmissionError(f"{path}: {error}") from None
    if not fits:
        raise SubmissionError(
            f"{path}: policy is {submission.policy[:LONGEST]!r}, which does not fit its files "
            f"{sorted(submission.files)!r:.80}; submit it again"
        )
    for name, expected in submission.files.items():
        _require_file(folder / name, expected)
    if (current := scenario_hash(scenario)) != submission.scenario_hash:
        raise SubmissionError(
            f"{path}: scenario_hash is {submission.scenario_hash[:16]!r}, that of {submission.scenario} is {current}; "
            "the preset has changed, submit again"
        )


def _fits(submission: Submission) -> bool:
    """Whether the text of a controller is of the kind of its files; ValueError for arguments other than literals."""
    _, inner = split_prefix(submission.policy)
    names = set(submission.files)
    if names == {CODE}:
        reference = parse(inner)
        return reference is not None and reference.where == CODE
    return inner == POLICY if names == {POLICY, CARD} else not names and is_bundled(inner)


def _require_file(path: Path, expected: str) -> None:
    if not is_file(path, SubmissionError):
        raise SubmissionError(f"{path}: is missing, and {SUBMISSION} names it; submit again")
    if (size_mib := path.stat().st_size / 2**20) > MOST_MIB:
        raise SubmissionError(f"{path}: has {size_mib:.0f} MiB; give a file of at most {MOST_MIB} MiB")
    if (current := sha256_of(path)) != expected:
        raise SubmissionError(
            f"{path}: sha256 is {current[:16]}.., {SUBMISSION} has {expected[:16]!r}; the file was changed after "
            "submission: submit it again"
        )


def spec_of(folder: Path, submission: Submission, trust: bool = False) -> str:
    """Return the text that names the controller of an entry here, see ``find_controller``.

    Parameters
    ----------
    folder
        Folder of the entry.
    submission
        Content of its submission.json, which passed ``require_unchanged``.
    trust
        Whether code of the submitter may run.

    Raises
    ------
    SubmissionError
        If the entry has code and is not trusted.
    """
    if submission.has_code and not trust:
        raise SubmissionError(
            f"{folder / SUBMISSION}: policy is {submission.policy!r}, code of the submitter, which would run here; "
            f"read {CODE}, and run the command with --trust in a container (docs/leaderboard.md)"
        )
    before, inner = split_prefix(submission.policy)
    return f"{before}{folder.resolve() / inner}" if submission.files else submission.policy
