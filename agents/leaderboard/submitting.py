"""From a controller to a folder that claims what it reaches."""

from __future__ import annotations

import platform
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from dcgrid_env import Scenario, scenario_hash
from dcgrid_env.agents.controllers import trained_on, without_horizon
from dcgrid_env.agents.from_sb3.sb3_policy import convert
from dcgrid_env.agents.from_sb3.sb3_zip import SUFFIX as ZIP
from dcgrid_env.agents.leaderboard.confinement import version
from dcgrid_env.agents.leaderboard.entry_files import (
    CARD,
    CODE,
    CONTROLLER,
    FILE,
    FORMAT,
    NAMED,
    POLICY,
    SUBMISSION,
    Learned,
    Submission,
    SubmissionError,
    check_card,
    check_words,
    plain,
)
from dcgrid_env.agents.leaderboard.remote import require_system
from dcgrid_env.agents.leaderboard.running import Runner, controller_of, episodes_hash, run, scenario_of, scored
from dcgrid_env.agents.leaderboard.scopes import Scope, measured_scope
from dcgrid_env.agents.policy.guard import GuardedPolicy
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.policy.policy_file import SUFFIX
from dcgrid_env.agents.policy.trial_guard import TriedPolicy
from dcgrid_env.baselines.registry import CONTROLLER_REGISTRY, controller_file, require_known, split_prefix
from dcgrid_env.baselines.user_code import parse
from dcgrid_env.core.files import sha256_of, whole_folder, write_bytes, write_json
from dcgrid_env.core.versions import PACKAGES, versions


class _Entry(NamedTuple):
    kind: str
    policy: str
    """What names the controller in the folder."""
    files: dict[str, Path]
    """What is copied, by its name there."""


def installed() -> dict[str, str | None]:
    """Versions of Python and of the packages that figures depend on."""
    return {"python": platform.python_version(), **versions(PACKAGES)}


def machine() -> str:
    """Operating system and kind of processor."""
    return f"{platform.system()} {platform.machine()}"


def submit(
    policy: str, name: str, out: Path, *, paper: str = "", scenario: str | None = None, episodes: int = 100,
    learned_on: Learned = "train", scope: str = "",
) -> Submission:  # fmt: skip
    """Run a controller on the test episodes of a preset, and write a folder that claims what it came to.

    Parameters
    ----------
    policy
        Name of the controller, see ``find_controller``; for a user's code ``path/to/file.py:Class``. A model of
        Stable-Baselines3 becomes a policy file.
    name, paper
        What the entry is called on the page, and where it is described.
    out
        Folder to be made.
    scenario
        Preset on whose test split it is scored; by default the one that the policy was trained on.
    episodes
        Seeds 0, 1, .. of the test split.
    learned_on
        Declaration of the split that it was learned or tuned on.
    scope
        Scope of the data sent to own code, see ``scopes``; the scope of other controllers is measured.

    Raises
    ------
    ValueError
        If the entry is invalid or cannot be scored, before anything is written.
    """
    require_system()
    check_words(name=name, paper=paper)
    before, inner = split_prefix(policy)
    file = controller_file(inner)
    if file is not None and file.suffix == ZIP:
        with TemporaryDirectory() as folder:
            converted = convert(file, Path(folder) / POLICY)
            return submit(
                f"{before}{converted}", name, out, paper=paper, scenario=scenario, episodes=episodes,
                learned_on=learned_on, scope=scope,
            )  # fmt: skip
    entry = _entry(policy)
    if (entry.kind == CODE) != bool(scope):
        raise SubmissionError(
            f"scope is {scope!r}; "
            + (
                "say what the code is to be sent, such as local"
                if entry.kind == CODE
                else "leave it out: it is measured"
            )
        )
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise SubmissionError(f"out is {str(out)!r}, which is there and not empty; choose another folder")
    test = scenario_of(scenario or _trained_on(policy))
    of_episodes = episodes_hash(test, episodes)
    runner, weights = runner_of(policy, test, scope, entry.files.get(CONTROLLER))
    (driven,) = run(runner, test, [range(episodes)], name)
    claimed = Submission(
        format=FORMAT, name=name, paper=paper, kind=entry.kind, policy=entry.policy,  # pyright: ignore[reportArgumentType]
        sha256="".join(map(sha256_of, entry.files.values())) if weights is None else weights.sha256,
        files={file: sha256_of(path) for file, path in entry.files.items()},
        scenario=test.name, scenario_hash=scenario_hash(test), episodes=episodes, episodes_hash=of_episodes,
        scope=str(runner.scope), learned_on=learned_on,
        versions=installed(), machine=machine(), claimed=driven.figures, score=scored(driven),
    )  # fmt: skip
    if claimed.kind == FILE:
        check_card(entry.files[CARD], claimed)
    with whole_folder(out) as folder:
        for file, path in entry.files.items():
            write_bytes(folder / file, path.read_bytes())
        write_json(folder / SUBMISSION, plain(claimed))
    return claimed


def runner_of(
    policy: str, scenario: Scenario, scope: str, code: Path | None, confined: bool | None = None
) -> tuple[Runner, Policy | None]:
    """What is run of an entry, and the policy in it; ValueError for what names no controller.

    Parameters
    ----------
    policy
        What names the controller.
    scenario
        The preset on its test split.
    scope
        What code is sent; that of others is measured.
    code
        The submitter's file, where it is code, which is not run here.
    confined
        Whether code is confined; by default where the system can.
    """
    if code is not None:
        before, inner = split_prefix(policy)
        reference = parse(inner)
        assert reference is not None  # what is no class was refused before
        spec = f"{before}{CONTROLLER}{inner[len(reference.where) :]}"
        return Runner(spec, Scope.parse(scope), code, bool(version()) if confined is None else confined), None
    inner: Any = controller_of(policy, scenario)
    inner = inner.policy if isinstance(inner, GuardedPolicy | TriedPolicy) else inner
    measured = measured_scope(lambda: controller_of(policy, scenario), scenario, policy)
    return Runner(policy, measured), inner if isinstance(inner, Policy) else None


def _entry(policy: str) -> _Entry:
    """Form of a controller in a folder; SubmissionError for one that a folder cannot contain."""
    before, inner = split_prefix(policy)
    reference = parse(inner)
    if reference is not None:
        if reference.path is None:
            raise SubmissionError(f"policy is {policy!r}; give path/to/file.py:Class, whose file goes into the folder")
        if not reference.path.is_file():
            raise SubmissionError(f"policy is {policy!r}; there is no file {reference.where}")
        return _Entry(CODE, f"{CONTROLLER}{inner[len(reference.where) :]}", {CONTROLLER: reference.path})
    path = controller_file(inner)
    if path is not None and path.suffix == SUFFIX:
        card = path.with_suffix(".json")
        for needed in (path, card):
            if not needed.is_file():
                raise SubmissionError(f"policy is {policy!r}; there is no file {needed} (Policy.save writes both)")
        return _Entry(FILE, f"{before}{POLICY}", {POLICY: path, CARD: card})
    if (origin := CONTROLLER_REGISTRY.origin(inner) if inner in CONTROLLER_REGISTRY else None) is not None:
        raise SubmissionError(f"policy is {policy!r}, which comes from {origin}; give the file of its class")
    return _Entry(NAMED, policy, {})


def _trained_on(policy: str) -> str:
    """Return the preset that a policy was trained on; raise SubmissionError if there is none."""
    if where := trained_on(policy):
        return without_horizon(where)
    require_known(split_prefix(policy)[1])
    raise SubmissionError(f"policy {policy!r} was not trained on a preset; pass --scenario (dcgrid list)")
