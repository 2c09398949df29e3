"""The leaderboard: our own entries, and the table of verified folders that docs/extensions puts on its page."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import tyro

from dcgrid_env import PRESETS
from dcgrid_env.agents.policy.policy import SHIPPED
from dcgrid_env.apps.leaderboard.entries import SUBMISSION, Learned, Submission, SubmissionError
from dcgrid_env.apps.leaderboard.rounds import Report, read_report, verify
from dcgrid_env.apps.leaderboard.submit_command import submit
from dcgrid_env.baselines.scenario_names import scenario_names
from dcgrid_env.baselines.score import PUBLISHED_EPISODES, Estimate
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.terminal import plain_console, say
from docs.studies.publishing.agents import ALGORITHMS
from docs.studies.publishing.site_tables import number, plain, sortable, unbroken, with_interval

FOLDER = Path(__file__).parents[2] / "leaderboard"
"""Our entries."""
LAWS: dict[str, Learned] = {"mpc": "nothing", "model-aided": "nothing", "constant-q-tuned": "validation"}
"""Further controllers, and the split that their parameters were found on."""
LEFT_OUT = {("ieee123-3ph-day", "mpc")}
"""Takes more than two minutes of CPU for 32 episodes."""
HEADER = ("entry", "preset", "J saved, %", "J", "mean delay, s", "information", "learned on")


class Listed(NamedTuple):
    """A verified entry."""

    submission: Submission
    report: Report


def all_listed(folders: Sequence[Path]) -> list[Listed]:
    """Return the entries of verified folders, or of folders that contain such.

    Raises
    ------
    SubmissionError
        If an entry is invalid or has changed since verification, two entries of a preset have the same name, or
        reports are of different rounds.
    """
    seen: dict[tuple[str, str], Path] = {}
    entries: list[Listed] = []
    for folder in _entry_folders(folders):
        entry = Listed(*read_report(folder))
        name, preset = entry.submission.name, entry.submission.scenario
        if (other := seen.setdefault((preset, name), folder)) is not folder:
            raise SubmissionError(
                f"{folder / SUBMISSION}: {other} also has the name {name!r} on {preset}; give it another name"
            )
        entries.append(entry)
        rounds = [(one.report.round_seed, len(one.report.J)) for one in (entries[0], entry)]
        if rounds[0] != rounds[1]:
            raise SubmissionError(
                f"{folder}: round_seed and number of episodes are {rounds[1]}, other reports have {rounds[0]}; verify "
                "all entries in one round"
            )
    return entries


def _entry_folders(folders: Sequence[Path]) -> Iterator[Path]:
    for folder in folders:
        below = sorted(path.parent for path in folder.glob(f"*/{SUBMISSION}"))
        yield from [folder] if (folder / SUBMISSION).exists() or not below else below


def tables(entries: Sequence[Listed]) -> str:
    """Return the table as Markdown, and another one of entries that were learned on the test split."""
    others = [entry for entry in entries if entry.submission.learned_on != "test"]
    on_test = [entry for entry in entries if entry.submission.learned_on == "test"]
    rounds = {(entry.report.round_seed, len(entry.report.J)) for entry in entries}
    parts = [f"Round {seed}, {n} episodes on each preset." for seed, n in rounds]
    parts += [_table(others)] if others else []
    parts += ["### Learned or tuned on the test split", _table(on_test)] if on_test else []
    return "\n\n".join(parts) + "\n"


def _table(entries: Sequence[Listed]) -> str:
    """Return a table with a row for each entry, by preset, the largest saving first."""
    order = list(PRESETS)
    placed = sorted(entries, key=lambda e: (order.index(e.submission.scenario), -e.report.saved_pct[0]))
    return sortable(HEADER, [_row(entry) for entry in placed])


def _row(entry: Listed) -> tuple[str, ...]:
    submission, report = entry
    name = plain(submission.name)
    if submission.paper:
        link = submission.paper.startswith(("https://", "http://")) and not set(submission.paper) & set(" ()<>|")
        name = f"[{name}]({submission.paper})" if link else f"{name} ({plain(submission.paper)})"
    return (
        name + " (code)" * submission.has_code, submission.scenario, with_interval(Estimate(*report.saved_pct), 1),
        number(sum(report.J) / len(report.J), 4), number(report.delay_mean_s, 2), unbroken(plain(report.information)),
        submission.learned_on,
    )  # fmt: skip


@dataclass(frozen=True)
class Leaderboard(Command):
    """Check that verified folders can be listed.

    Checks files, hashes and reports, and runs nothing. The page of the site is made from docs/leaderboard.
    """

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Folders with reports of dcgrid verify, or folders that contain such."""

    def run(self) -> None:
        """Check, print. ValueError for a folder that cannot be listed."""
        say(plain_console(), f"{len(all_listed(self.folders))} entries can be listed")


@dataclass(frozen=True)
class LeaderboardEntries(Command):
    """Make our leaderboard entries and score them in a round."""

    round_seed: int
    """Number of the round."""
    scenarios: str = "all"
    """Names of presets, separated by commas, or all."""

    def run(self) -> None:
        """Submit, verify and write the entries."""
        console = plain_console()
        for scenario in scenario_names(self.scenarios):
            for folder in _submitted(scenario):
                _, report = verify(folder, self.round_seed)
                say(console, f"{folder}: saves {report.saved_pct[0]:.2f} % of the tuned droop's J")


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
