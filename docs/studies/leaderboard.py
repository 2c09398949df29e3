"""The leaderboard: our own entries, and the table of verified folders that docs/extensions puts on its page."""

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
from dcgrid_env.agents.leaderboard.signing import NEW_KEY, make_keys, private_key, private_key_file
from dcgrid_env.agents.leaderboard.submitting import submit
from dcgrid_env.agents.leaderboard.verifying import draw_seed, require_report, verify
from dcgrid_env.agents.policy.policy import SHIPPED, Policy
from dcgrid_env.baselines.registry import CONTROLLER_REGISTRY, split_prefix
from dcgrid_env.baselines.scenario_names import scenario_names
from dcgrid_env.baselines.score import PUBLISHED_EPISODES, Estimate
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.terminal import plain_console, say
from docs.studies.agents import ALGORITHMS
from docs.studies.site_tables import NBSP, number, plain, sortable, unbroken, with_interval

FOLDER = Path(__file__).parents[1] / "leaderboard"
"""Our entries."""
LAWS: dict[str, Learned] = {"mpc": "nothing", "model-aided": "nothing", "constant-q-tuned": "validation"}
"""Further controllers, and the split that their parameters were found on."""
LEFT_OUT = {("ieee123-3ph-day", "mpc")}
"""Takes more than two minutes of CPU for 32 episodes, of which an entry needs 96."""
HEADER = (
    "entry", "preset", "J saved, fresh, %", "J saved, published, %", "score", "J", "mean delay, s", "episodes", "sent",
    "learned on",
)  # fmt: skip


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


def all_listed(folders: Sequence[Path]) -> list[Listed]:
    """Entries of verified folders, or of folders of such.

    SubmissionError for a folder that cannot be listed, and for two entries of one name on a preset.
    """
    seen: dict[tuple[str, str], Path] = {}
    entries = []
    for folder in _entry_folders(folders):
        entry = listed(folder)
        name, preset = entry.submission.name, entry.submission.scenario
        if (other := seen.setdefault((preset, name), folder)) is not folder:
            raise SubmissionError(
                f"{folder / SUBMISSION}: {other} also has the name {name!r} on {preset}; give it another name"
            )
        entries.append(entry)
    return entries


def _entry_folders(folders: Sequence[Path]) -> Iterator[Path]:
    for folder in folders:
        below = sorted(path.parent for path in folder.glob(f"*/{SUBMISSION}"))
        yield from [folder] if (folder / SUBMISSION).exists() or not below else below


def tables(entries: Sequence[Listed]) -> str:
    """The table as Markdown, and another one of entries that were learned on the test split."""
    others = [entry for entry in entries if entry.submission.learned_on != "test"]
    on_test = [entry for entry in entries if entry.submission.learned_on == "test"]
    parts = [_table(others)] if others else []
    parts += ["### Learned or tuned on the test split", _table(on_test)] if on_test else []
    return "\n\n".join(parts) + "\n"


def _table(entries: Sequence[Listed]) -> str:
    """A row for each entry, by preset, the largest saving on fresh episodes first."""
    order = list(PRESETS)
    placed = sorted(entries, key=lambda e: (order.index(e.submission.scenario), -e.verified.fresh.gain[0]))
    return sortable(HEADER, [_row(entry) for entry in placed])


def _row(entry: Listed) -> tuple[str, ...]:
    submission, record = entry
    found, name = record.found, plain(submission.name)
    if submission.paper:
        link = submission.paper.startswith(("https://", "http://")) and not set(submission.paper) & set(" ()<>|")
        name = f"[{name}]({submission.paper})" if link else f"{name} ({plain(submission.paper)})"
    code = " (code)" if submission.kind == CODE else ""
    return (
        name + code, submission.scenario, _gain(record.fresh.gain) + f"{NBSP}below" * record.gains_less,
        _gain(found.gain), with_interval(Estimate(*record.score), 2), number(found.J, 4),
        number(found.delay_mean_s, 2), unbroken(f"{submission.episodes} + {record.fresh_episodes}"),
        unbroken(record.scope), submission.learned_on,
    )  # fmt: skip


def _gain(gain: tuple[float, float, float]) -> str:
    return with_interval(Estimate(*(100.0 * share for share in gain)), 1)


@dataclass(frozen=True)
class Leaderboard(Command):
    """Check that verified folders can be listed.

    Checks the signatures of their reports, and runs nothing. The page of the site is made from docs/leaderboard.
    """

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Folders that dcgrid verify has been through, or folders of such."""

    def run(self) -> None:
        """Check, print. ValueError for a folder that cannot be listed."""
        say(plain_console(), f"{len(all_listed(self.folders))} entries can be listed")


@dataclass(frozen=True)
class LeaderboardEntries(Command):
    """Make, verify and sign our own entries of the leaderboard.

    The fresh episodes of a run begin at one seed, which is drawn after the last
    entry was submitted. Reports are signed with the key in $DCGRID_VERIFIER_KEY, by default
    ~/.config/dcgrid/verifier.key.
    """

    scenarios: str = "all"
    """Names of presets, separated by commas, or all."""
    new_key: bool = False
    """Make a new key first. Reports that were signed with the keys before stay valid."""

    def run(self) -> None:
        """Submit, verify and write the entries. Raise ValueError before the first run if the key is missing."""
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
