"""Read and check the files of a leaderboard entry: submission.json, the files that it names, and verified.json.

``verified.json`` is the report of ``dcgrid verify``. It contains the hashes of submission and policy and a signature
over its contents (``signing``), so only reports of the verifier are listed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

from pydantic import ConfigDict, TypeAdapter, ValidationError

from dcgrid_env.agents.policy.card import Card
from dcgrid_env.baselines.score import SPLIT
from dcgrid_env.core.files import sha256_of
from dcgrid_env.core.user_files import is_file, read_bytes

SUBMISSION, VERIFIED = "submission.json", "verified.json"
FORMAT = 2
"""Format version of both files."""
Learned = Literal["train", "validation", "test", "nothing"]
"""Split on which an entry was trained or tuned."""
POLICY, CARD, CONTROLLER = "policy.safetensors", "policy.json", "controller.py"
"""File names in the folder of an entry."""
SCORE_TOLERANCE = 5e-3
"""Maximum difference of scores, and of delays in seconds: half of the last digit in tables."""
LONGEST = 80
"""Maximum length of a name or a paper, in characters."""
NAMED, FILE, CODE = "named", "file", "code"
T = TypeVar("T")


class SubmissionError(ValueError):
    """Report an invalid or changed entry; the message names file, field, value and remedy."""


class Figures(NamedTuple):
    """Results of a controller and of the tuned droop on the same episodes."""

    J: float
    J_droop: float
    gain: tuple[float, float, float]
    """1 - J / J_droop, with means over the episodes, and the bounds of its 95 % interval over episodes."""
    delay_mean_s: float
    droop_delay_mean_s: float


class Score(NamedTuple):
    """Score and the bounds of its 95 % interval; the tuned droop has score 0, hindsight 1."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Submission:
    """Claimed results of a controller on the test split of a preset."""

    __pydantic_config__ = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    format: int
    name: str
    """Name of the entry on the leaderboard page."""
    paper: str
    """Reference to a description of the controller."""
    kind: Literal["named", "file", "code"]
    """Kind of controller: a registered name, a policy file, or code of the submitter."""
    policy: str
    """Name or file of the controller; for code, also class and arguments."""
    sha256: str
    """``Policy.sha256`` of a policy or SHA-256 of a code file; empty for a controller of the package."""
    files: dict[str, str]
    """SHA-256 of each file of the entry, by name."""
    scenario: str
    """Name of the preset."""
    scenario_hash: str
    """Hash of the preset on its test split."""
    episodes: int
    """Seeds 0, 1, .. of the test split."""
    episodes_hash: str
    """SHA-256 over the hashes of the claimed episodes and their published costs."""
    scope: str
    """Scope of the data sent to the controller (``scopes``): chosen for code of the submitter, measured for others."""
    learned_on: Learned
    """Split on which the controller was trained or tuned, as declared by the submitter."""
    versions: dict[str, str | None]
    """Versions of Python and packages with which the results were computed."""
    machine: str
    claimed: Figures
    score: Score


@dataclass(frozen=True)
class Verified:
    """Results of the verification of an entry."""

    __pydantic_config__ = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    format: int
    submission: str
    """SHA-256 of submission.json."""
    policy: str
    """SHA-256 of the policy, as in the submission."""
    scenario_hash: str
    episodes_hash: str
    reference: str
    """Controller with score 0, and its parameters."""
    scope: str
    """Scope of the data that was sent to the controller."""
    found: Figures
    """Results on the claimed episodes."""
    score: Score
    fresh_seed: int
    """Seed of the first fresh episode, drawn for this report."""
    fresh_episodes: int
    fresh: Figures
    """Results on the fresh episodes."""
    versions: dict[str, str | None]
    machine: str
    signature: str = ""
    """Signature over all other fields; empty if the verifier has no key."""

    @property
    def gains_less(self) -> bool:
        """Whether the gain on fresh episodes is below that on claimed episodes, without overlap of the intervals."""
        return self.fresh.gain[2] < self.found.gain[1]

    @property
    def signed_content(self) -> bytes:
        """Contents to sign: all fields except the signature."""
        return json.dumps(plain(self) | {"signature": ""}, sort_keys=True).encode()


def plain(record: Submission | Verified) -> dict[str, Any]:
    """Convert a record to JSON types."""
    return {name: value._asdict() if hasattr(value, "_asdict") else value for name, value in asdict(record).items()}


def read(path: Path, kind: type[T]) -> T:
    """Read a record; raise SubmissionError, with file and field, if it is invalid or missing."""
    if not is_file(path, SubmissionError):
        remedy = {SUBMISSION: "give a folder that dcgrid submit wrote", VERIFIED: "run dcgrid verify on the folder"}
        raise SubmissionError(f"{path}: there is no such file; {remedy[path.name]}")
    try:
        record = TypeAdapter(kind).validate_json(read_bytes(path, SubmissionError))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"])) or "it"
        raise SubmissionError(f"{path}: {field}: {first['msg'].lower()}; submit and verify again") from None
    number = getattr(record, "format", None)
    if number != FORMAT:
        raise SubmissionError(f"{path}: format is {number}, this dcgrid reads {FORMAT}; update dcgrid-env")
    return record


def check_words(**words: str) -> None:
    """Raise SubmissionError if a text of the submitter does not fit into a table cell or the name is empty."""
    for field, text in words.items():
        if len(text) > LONGEST or not text.isprintable() or (field == "name" and not text.strip()):
            raise SubmissionError(f"{field} is {text!r}; give one line of 1 to {LONGEST} letters")


def check_card(path: Path, submission: Submission) -> None:
    """Raise SubmissionError if a card is for another policy or has another score on the same episodes.

    Raises PolicyError if the file is not a card.
    """
    card = Card.load(path)
    if card.sha256 != submission.sha256:
        raise SubmissionError(
            f"{path}: sha256 is {card.sha256[:16]}.., that of the policy is {submission.sha256[:16]}..; give the card "
            "that was saved with it"
        )
    scored = card.scored
    if scored is None or submission.policy != POLICY:
        return  # under guard it acts otherwise than its card says
    if (scored.scenario_hash, scored.split, scored.episodes) != (submission.scenario_hash, SPLIT, submission.episodes):
        return
    for name, one, other in (("J", scored.J, submission.claimed.J), ("score", scored.score[0], submission.score.value)):
        if abs(one - other) > SCORE_TOLERANCE * max(1.0, abs(other)):
            raise SubmissionError(
                f"{path}: scored.{name} is {one:.6g}, claimed is {other:.6g}; give a card that says what the policy "
                "reaches, or one without scored"
            )


def check_contents(folder: Path, submission: Submission) -> None:
    """Raise SubmissionError if a text does not fit into a table cell or a file has changed since submission."""
    try:
        check_words(name=submission.name, paper=submission.paper, scope=submission.scope)
    except SubmissionError as error:
        raise SubmissionError(f"{folder / SUBMISSION}: {error}") from None
    _check_files(folder, submission.files)


def _check_files(folder: Path, files: Mapping[str, str]) -> None:
    """Raise SubmissionError if a file is missing, is outside the folder, or has another hash."""
    for name, expected in files.items():
        path = folder / name
        if Path(name).name != name:
            raise SubmissionError(f"{folder / SUBMISSION}: files: {name!r} is outside the folder; submit again")
        if not is_file(path, SubmissionError):
            raise SubmissionError(f"{path}: is missing, and submission.json names it; submit again")
        if (found := sha256_of(path)) != expected:
            raise SubmissionError(
                f"{path}: sha256 is {found[:16]}.., submission.json says {expected[:16]}..; the file was changed after "
                "it was submitted: submit it again"
            )
