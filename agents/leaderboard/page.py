"""The leaderboard's page: the tables of verified folders, between two marks of a Markdown file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from dcgrid_env import PRESETS, scenario_hash
from dcgrid_env.agents.leaderboard.entry_files import (
    CODE,
    NAMED,
    SUBMISSION,
    VERIFIED,
    Submission,
    SubmissionError,
    Verified,
    check_contents,
    read,
)
from dcgrid_env.agents.leaderboard.running import episodes_hash, reference, scenario_of
from dcgrid_env.agents.leaderboard.scopes import LOCAL, SENSITIVITIES, Scope
from dcgrid_env.agents.leaderboard.verifying import require_report
from dcgrid_env.agents.policy.policy import SHIPPED, Policy
from dcgrid_env.baselines.registry import CONTROLLER_REGISTRY, split_prefix
from dcgrid_env.baselines.score import PUBLISHED_EPISODES
from dcgrid_env.core.files import write_text

_NBSP = "\u00a0"
BEGIN, END = "<!-- leaderboard: begin -->", "<!-- leaderboard: end -->"
"""Comments before and after the tables in the page."""
HEADER = (
    "| scenario | entry | saved of the droop's J, fresh episodes | saved, published | score (95 %) | J | delay, s | "
    "episodes | sent | learned on |"
)


class Listed(NamedTuple):
    """A verified entry."""

    submission: Submission
    verified: Verified

    @property
    def gains_less(self) -> bool:
        """Whether the gain on fresh episodes lies below that on the claimed ones, their intervals apart."""
        return self.verified.fresh.gain[2] < self.verified.found.gain[1]


def listed(folder: Path) -> Listed:
    """The entry of a verified folder.

    Raises
    ------
    SubmissionError
        For a folder that was not verified, or of which anything has changed since: a file, a record, the preset, or
        the policy that ships under the entry's name.
    """
    submission, record = read(folder / SUBMISSION, Submission), read(folder / VERIFIED, Verified)
    path = folder / VERIFIED
    require_report(folder, record)
    check_contents(folder, submission)
    for path_, name, n in (
        (folder / SUBMISSION, "episodes", submission.episodes), (path, "fresh_episodes", record.fresh_episodes),
    ):  # fmt: skip
        if n < PUBLISHED_EPISODES:
            raise SubmissionError(f"{path_}: {name} is {n}; the page takes at least {PUBLISHED_EPISODES}")
    scenario = scenario_of(submission.scenario)
    now = {
        "scenario_hash": scenario_hash(scenario), "episodes_hash": episodes_hash(scenario, submission.episodes),
        "reference": reference(scenario),
    }  # fmt: skip
    for name, value in now.items():
        if (reported := getattr(record, name)) != value:
            raise SubmissionError(f"{path}: {name} is {reported}, now {value}; submit and verify again")
    _, inner = split_prefix(submission.policy)
    if submission.kind == NAMED and inner not in CONTROLLER_REGISTRY:
        raise SubmissionError(f"{path}: policy is {inner!r}, which no longer ships; delete the folder")
    if submission.kind == NAMED and inner in SHIPPED and Policy.load(inner).sha256 != record.policy:
        raise SubmissionError(f"{path}: policy is of other weights than {inner} that ships; submit and verify again")
    return Listed(submission, record)


def write_page(folders: Sequence[Path], page: Path) -> int:
    """Put the tables of these folders between the marks of a page; the number of entries.

    SubmissionError, before anything is written, for a folder that cannot be listed, two entries of one name on a
    scenario, or a page without the marks.
    """
    text = page.read_text(encoding="utf-8")
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise SubmissionError(f"{page}: has not one line {BEGIN} and one {END} behind it; put them in")
    entries = [listed(folder) for folder in folders]
    seen: dict[tuple[str, str], Path] = {}
    for folder, (submission, _) in zip(folders, entries, strict=True):
        other = seen.setdefault((submission.scenario, submission.name), folder)
        if other is not folder:
            raise SubmissionError(
                f"{folder / SUBMISSION}: name {submission.name!r} stands in {other} too, for {submission.scenario}; "
                "give it another name"
            )
    before, behind = text.split(BEGIN)[0], text.split(END)[1]
    write_text(page, f"{before}{BEGIN}\n{tables(entries)}\n{END}{behind}")
    return len(entries)


def tables(entries: Sequence[Listed]) -> str:
    """The tables, as Markdown: by what entries are sent, what was learned on the test split apart."""
    groups = {
        "Local measurements": [e for e in entries if _group(e) == str(Scope.of(LOCAL))],
        "Local measurements and own sensitivities": [
            e for e in entries if _group(e) == str(Scope.of(LOCAL, SENSITIVITIES))
        ],
        "More than that": [e for e in entries if _group(e) == "more"],
        "Learned or tuned on the test split, as declared": [e for e in entries if _group(e) == "test"],
    }
    parts = [
        "\n".join([f"### {title}\n", HEADER, "|---" * 2 + "|---:" * 6 + "|---" * 2 + "|", *_rows(members)])
        for title, members in groups.items()
        if members
    ]
    return "\n" + "\n\n".join(parts) + "\n"


def _group(entry: Listed) -> str:
    if entry.submission.learned_on == "test":
        return "test"
    scope = entry.verified.scope
    return scope if scope in map(str, (Scope.of(LOCAL), Scope.of(LOCAL, SENSITIVITIES))) else "more"


def _rows(entries: Sequence[Listed]) -> list[str]:
    """A row for each entry, by scenario in the presets' order, the largest saving on fresh episodes first."""
    order = list(PRESETS)
    placed = sorted(entries, key=lambda e: (order.index(e.submission.scenario), -e.verified.fresh.gain[0]))
    return [_row(entry) for entry in placed]


def _row(entry: Listed) -> str:
    submission, record = entry
    score, found = record.score, record.found
    name = _cell(submission.name)
    if submission.paper:
        link = submission.paper.startswith(("https://", "http://")) and not set(submission.paper) & set(" ()<>|")
        name = f"[{name}]({submission.paper})" if link else f"{name} ({_cell(submission.paper)})"
    code = " (code)" if submission.kind == CODE else ""
    cells = (
        f"`{submission.scenario}`", name + code, _gain(record.fresh.gain) + " below" * entry.gains_less,
        _gain(found.gain), f"{score.value:.2f} {_interval(score.low, score.high, 2)}", f"{found.J:.4f}",
        f"{found.delay_mean_s:.2f}", f"{submission.episodes}, {record.fresh_episodes}", record.scope,
        submission.learned_on,
    )  # fmt: skip
    return f"| {' | '.join(cells)} |"


def _gain(gain: tuple[float, float, float]) -> str:
    value, low, high = (100.0 * share for share in gain)
    return f"{value:.1f}{_NBSP}% {_interval(low, high, 1)}"


def _interval(low: float, high: float, decimals: int) -> str:
    """An interval in brackets, which no cell of a table breaks apart."""
    return f"({low:.{decimals}f} .. {high:.{decimals}f})".replace(" ", _NBSP)


def _cell(text: str) -> str:
    """A submitter's text, which cannot break the table or add markup."""
    for sign in "\\|`*_[]<>":
        text = text.replace(sign, f"\\{sign}" if sign not in "<>" else {"<": "&lt;", ">": "&gt;"}[sign])
    return text
