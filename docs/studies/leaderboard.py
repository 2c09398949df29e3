"""The leaderboard: our own entries, and the page with the tables of verified folders."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import tyro

from dcgrid_env import PRESETS, scenario_hash
from dcgrid_env.agents.leaderboard.entry_files import (
    CODE,
    NAMED,
    SUBMISSION,
    VERIFIED,
    Learned,
    Submission,
    SubmissionError,
    Verified,
    check_contents,
    read,
)
from dcgrid_env.agents.leaderboard.running import episodes_hash, reference, scenario_of
from dcgrid_env.agents.leaderboard.scopes import LOCAL, SENSITIVITIES, Scope
from dcgrid_env.agents.leaderboard.signing import NEW_KEY, make_keys, private_key, private_key_file
from dcgrid_env.agents.leaderboard.submitting import submit
from dcgrid_env.agents.leaderboard.verifying import draw_seed, require_report, verify
from dcgrid_env.agents.policy.policy import SHIPPED, Policy
from dcgrid_env.baselines.registry import CONTROLLER_REGISTRY, split_prefix
from dcgrid_env.baselines.score import PUBLISHED_EPISODES
from dcgrid_env.cli.command import Command
from dcgrid_env.cli.names import scenario_names
from dcgrid_env.cli.terminal import plain_console, say
from dcgrid_env.core.files import write_text

FOLDER, PAGE = Path("docs/leaderboard"), Path("docs/leaderboard.md")
ALGORITHMS = ("analytic", "ppo", "ppo-counterfactual", "safe")
LAWS: dict[str, Learned] = {"mpc": "nothing", "model-aided": "nothing", "constant-q-tuned": "validation"}
"""Further controllers, and the split that their parameters were found on."""
LEFT_OUT = {("ieee123-3ph-day", "mpc")}
"""Takes more than two minutes of CPU for 32 episodes, of which an entry needs 96."""
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
        f"`{submission.scenario}`", name + code, _gain(record.fresh.gain) + " below" * record.gains_less,
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


@dataclass(frozen=True)
class Leaderboard(Command):
    """Make the leaderboard's tables from verified folders.

    Runs nothing.
    """

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Folders that dcgrid verify has been through, or folders of such."""
    page: Path = PAGE
    """Markdown file that has the two marks between which the tables are put."""

    def run(self) -> None:
        """Check, write, print. ValueError for a folder that is not verified, before anything is written."""
        entries: list[Path] = []
        for folder in self.folders:
            below = sorted(path.parent for path in folder.glob(f"*/{SUBMISSION}"))
            entries += [folder] if (folder / SUBMISSION).exists() or not below else below
        say(plain_console(), f"wrote {self.page}: {write_page(entries, self.page)} entries")


@dataclass(frozen=True)
class LeaderboardEntries(Command):
    """Make, verify and sign our own entries of the leaderboard.

    Makes the page of all entries, too. The fresh episodes of a run begin at one seed, which is drawn after the last
    entry was submitted. Reports are signed with the key in $DCGRID_VERIFIER_KEY, by default
    ~/.config/dcgrid/verifier.key.
    """

    scenarios: str = "all"
    """Names of presets, separated by commas, or all."""
    new_key: bool = False
    """Make a new key first; reports with another signature must then be replaced."""

    def run(self) -> None:
        """Submit, verify, write. ValueError where there is no key, before anything is run."""
        console, scenarios = plain_console(), scenario_names(self.scenarios)
        if self.new_key:
            make_keys()
        if private_key() is None:
            raise ValueError(
                f"there is no key in {private_key_file()}; copy the verifier's, or make one with {NEW_KEY}"
            )
        folders = [folder for scenario in scenarios for folder in _submitted(scenario)]
        seed = draw_seed()
        for folder in folders:
            _, found = verify(folder, seed, fresh=PUBLISHED_EPISODES)
            say(console, f"{folder}: score {found.score.value:.3f}, J {found.found.J:.4f}")
        Leaderboard((FOLDER,)).run()


def _submitted(scenario: str) -> Iterator[Path]:
    """Write our entries of a preset; their folders."""
    trained = {name: f"{scenario}-{name}" for name in ALGORITHMS if f"{scenario}-{name}" in SHIPPED}
    laws = {law: law for law in LAWS if (scenario, law) not in LEFT_OUT}
    for name, policy in (trained | laws).items():
        folder, learned_on = FOLDER / f"{scenario}-{name}", LAWS.get(name, "train")
        shutil.rmtree(folder, ignore_errors=True)
        try:
            submit(policy, name, folder, scenario=scenario, episodes=PUBLISHED_EPISODES, learned_on=learned_on)
        except ValueError as error:  # a controller that is not made for the preset's devices
            say(plain_console(), f"{scenario}, {name}: not entered: {error}")
            continue
        yield folder
