"""Entries of the leaderboard for the tests of this folder."""

import shutil
from pathlib import Path

import pytest

from dcgrid_env.agents.policy.policy import FOLDER
from dcgrid_env.apps.leaderboard.rounds import verify
from dcgrid_env.apps.leaderboard.submit_command import submit

ROUND = 7


@pytest.fixture(scope="session")
def entry(tmp_path_factory):
    """A verified folder with a policy file."""
    folder = tmp_path_factory.mktemp("entries") / "entry"
    submit(str(FOLDER / "toy6-analytic.safetensors"), "analytic", folder, paper="https://example.org", episodes=2)
    verify(folder, ROUND)
    return folder


@pytest.fixture(scope="session")
def named(tmp_path_factory):
    """A verified folder of a bundled policy."""
    folder = tmp_path_factory.mktemp("named") / "entry"
    submit("toy6-analytic", "bundled", folder, episodes=2)
    verify(folder, ROUND)
    return folder


@pytest.fixture
def copied(entry, tmp_path):
    return Path(shutil.copytree(entry, tmp_path / "copied"))
