"""Runs of the study over few episodes, shared by its tests."""

import pytest

from dcgrid_env.apps.reproduction.load import choose_load
from dcgrid_env.apps.reproduction.study_runs import Runs, Setting


@pytest.fixture(scope="session")
def few():
    return Runs(Setting(choose_load("generated"), episodes=3))
