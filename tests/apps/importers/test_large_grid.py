"""A large grid is imported in time that grows with its size; the whole measurement is
``tests/support/large_grid.py``."""

import time

import pytest
from large_grid import large_feeder

from dcgrid_env import Feeder
from dcgrid_env.apps.importers.matpower import read_matpower, write_matpower
from helpers.imports import assert_same_feeder


@pytest.mark.slow
def test_ten_thousand_buses_are_read_in_seconds(tmp_path):
    feeder = large_feeder()
    write_matpower(feeder, tmp_path / "large.m")
    begun = time.process_time()
    imported = read_matpower(tmp_path / "large.m")
    assert time.process_time() - begun < 10.0
    assert_same_feeder(feeder, Feeder.from_network(imported.network), rtol=1e-9)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_ten_thousand_buses_are_read_in_seconds_from_pandapower(tmp_path):
    pytest.importorskip("pandapower", reason="pandapower is not installed (extra pandapower)")
    from dcgrid_env.apps.importers.pandapower import read_pandapower, write_pandapower

    feeder = large_feeder()
    write_pandapower(feeder, tmp_path / "large.json")
    begun = time.process_time()
    imported = read_pandapower(tmp_path / "large.json")
    assert time.process_time() - begun < 10.0
    assert_same_feeder(feeder, Feeder.from_network(imported.network), rtol=1e-9)
