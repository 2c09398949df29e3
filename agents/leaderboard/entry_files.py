"""Contents of a leaderboard folder: submission.json, the files that it names, and verified.json once it is verified.

``verified.json`` is a report of ``dcgrid verify``, with the hashes of the submission and of the policy in it. It ends
in a signature over all that it says (``signing``), so that only reports of the verifier are listed.
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

SUBMISSION, VERIFIED = "submission.json", "verified.json"
FORMAT = 2
"""Version of both files' format."""
Learned = Literal["train", "validation", "test", "nothing"]
"""Split that an entry was learned or tuned on."""
POLICY, CARD, CONTROLLER = "policy.safetensors", "policy.json", "controller.py"
"""What an entry's files are called in its folder."""
SCORE_TOLERANCE = 5e-3
"""Largest difference of scores, and of delays in seconds: half of the last digit that tables show."""
LONGEST = 80
"""Letters of a name or a paper at most."""
NAMED, FILE, CODE = "named", "file", "code"
T = TypeVar("T")


class SubmissionError(ValueError):
    """A folder that is no entry, or no longer what it says; the message names file, field, value and remedy."""


class Figures(NamedTuple):
    """What a controller comes to on some episodes, beside the tuned droop on the same."""

    J: float
    J_droop: float
    gain: tuple[float, float, float]
    """1 - J / J_droop, both means over the episodes, and the ends of its 95 % interval over episodes."""
    delay_mean_s: float
    droop_delay_mean_s: float


class Score(NamedTuple):
    """A score and the ends of its 95 % interval; 0 is the tuned droop, 1 hindsight."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Submission:
    """What is claimed of a controller on the test split of a preset."""

    __pydantic_config__ = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    format: int
    name: str
    """What the entry is called on the page."""
    paper: str
    """Where it is described."""
    kind: Literal["named", "file", "code"]
    """Whether the controller is one that has a name, a policy's file, or the submitter's code."""
    policy: str
    """Its name, or its file within the folder, with class and arguments where it is code."""
    sha256: str
    """``Policy.sha256`` of a policy, SHA-256 of the file of code, empty for a controller that the package makes."""
    files: dict[str, str]
    """SHA-256 of each file in the folder that the entry consists of, by name."""
    scenario: str
    """Name of the preset."""
    scenario_hash: str
    """Hash of the preset on its test split."""
    episodes: int
    """Seeds 0, 1, .. of the test split."""
    episodes_hash: str
    """SHA-256 over the hashes of those episodes and their published costs."""
    scope: str
    """Scope of the data sent to the controller (``scopes``): chosen for code of the submitter, measured for others."""
    learned_on: Learned
    """Split that it was learned or tuned on, as its submitter declares it."""
    versions: dict[str, str | None]
    """Versions of Python and of the packages that the figures were made with."""
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
    """The controller of score 0 with its parameters."""
    scope: str
    """Scope of the data that was sent to the controller."""
    found: Figures
    """On the claimed episodes."""
    score: Score
    fresh_seed: int
    """Seed of the first fresh episode, drawn for this report."""
    fresh_episodes: int
    fresh: Figures
    """On the fresh episodes."""
    versions: dict[str, str | None]
    machine: str
    signature: str = ""
    """Signature over all the above; empty where the verifier has no key."""

    @property
    def gains_less(self) -> bool:
        """Whether the gain on fresh episodes lies below that on the claimed ones, their intervals apart."""
        return self.fresh.gain[2] < self.found.gain[1]

    @property
    def signed_content(self) -> bytes:
        """All but the signature, as it is signed."""
        return json.dumps(plain(self) | {"signature": ""}, sort_keys=True).encode()


def plain(record: Submission | Verified) -> dict[str, Any]:
    """A record as JSON has it."""
    return {name: value._asdict() if hasattr(value, "_asdict") else value for name, value in asdict(record).items()}


def read(path: Path, kind: type[T]) -> T:
    """Read a record; SubmissionError, naming file and field, for what is none, and where there is no file."""
    if not path.is_file():
        remedy = {SUBMISSION: "give a folder that dcgrid submit wrote", VERIFIED: "run dcgrid verify on the folder"}
        raise SubmissionError(f"{path}: there is no such file; {remedy[path.name]}")
    try:
        record = TypeAdapter(kind).validate_json(path.read_bytes())
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"])) or "it"
        raise SubmissionError(f"{path}: {field}: {first['msg'].lower()}; submit and verify again") from None
    number = getattr(record, "format", None)
    if number != FORMAT:
        raise SubmissionError(f"{path}: format is {number}, this dcgrid reads {FORMAT}; update dcgrid-env")
    return record


def check_words(**words: str) -> None:
    """SubmissionError unless what a submitter says of an entry fits into a cell of a table; its name is not empty."""
    for field, text in words.items():
        if len(text) > LONGEST or not text.isprintable() or (field == "name" and not text.strip()):
            raise SubmissionError(f"{field} is {text!r}; give one line of 1 to {LONGEST} letters")


def check_card(path: Path, submission: Submission) -> None:
    """SubmissionError unless a card is of an entry's policy, and claims no other score on the same episodes.

    PolicyError for what is no card.
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
    """SubmissionError unless an entry's words fit into a table and its files are those that were submitted."""
    try:
        check_words(name=submission.name, paper=submission.paper, scope=submission.scope)
    except SubmissionError as error:
        raise SubmissionError(f"{folder / SUBMISSION}: {error}") from None
    _check_files(folder, submission.files)


def _check_files(folder: Path, files: Mapping[str, str]) -> None:
    """SubmissionError unless a folder's files are there, within it, and have these hashes."""
    for name, expected in files.items():
        path = folder / name
        if Path(name).name != name:
            raise SubmissionError(f"{folder / SUBMISSION}: files: {name!r} is outside the folder; submit again")
        if not path.is_file():
            raise SubmissionError(f"{path}: is missing, and submission.json names it; submit again")
        if (found := sha256_of(path)) != expected:
            raise SubmissionError(
                f"{path}: sha256 is {found[:16]}.., submission.json says {expected[:16]}..; the file was changed after "
                "it was submitted: submit it again"
            )
