"""Figures of short episodes with every device and feature are those that ``recorded_episodes.json`` records."""

import importlib.util
import json
from pathlib import Path

import pytest

from dcgrid_env import Recorder, StreamingRecorder, action_layout
from dcgrid_env.engine.simulation import Simulation


def _load():
    path = Path(__file__).with_name("recorded_episodes.py")
    spec = importlib.util.spec_from_file_location("recorded_episodes", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


recorded = _load()
RECORDED = json.loads(recorded.FILE.read_text(encoding="utf-8"))


SLOW = ("all features", "two classes of work")
"""Episodes whose traces are generated first."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in recorded.SCENARIOS]
)
def test_figures_are_the_recorded_ones(name):
    found = json.loads(json.dumps(recorded.of_scenario(recorded.SCENARIOS[name]())))
    expected = RECORDED[name]
    assert found["declared"] == expected["declared"]
    assert found["display"] == expected["display"]
    for part in ("metrics", "costs"):
        assert found[part] == pytest.approx(expected[part], rel=1e-7, abs=1e-9), part
    assert found["observed"] == pytest.approx(expected["observed"], rel=1e-6, abs=1e-6)


def test_the_recorded_episodes_have_every_event():
    """A figure that stays zero would not notice a fault in what computes it."""
    for name, figures in {
        "all features": ("burnt_kwh", "held_back_kws", "moved_kws", "cooling_kwh", "site_storage_loss_kwh"),
        "two classes of work": ("moved_kws", "lateness_mean_s", "delay_mean_s"),
        "leaving": ("ups_trips", "ups_locked_s", "battery_energy_kws", "inverter_trips", "inverter_away_s"),
        "leaving by agent": ("battery_work_kws", "ups_locked_s"),
        "storages": ("storage_throughput_kwh", "storage_missing_kwh"),
        "agents of equipment": ("tap_moves", "capacitor_switchings"),
        "set points of equipment": ("tap_moves",),
        "controlled by power": ("tap_moves", "capacitor_switchings"),
        "controlled by voltage": ("tap_moves", "capacitor_switchings"),
    }.items():
        assert all(RECORDED[name]["metrics"][figure] > 0.0 for figure in figures), name


@pytest.mark.parametrize("name", recorded.SCENARIOS)
def test_figures_of_parts_are_those_of_the_whole_episode(name):
    scenario = recorded.SCENARIOS[name]()
    simulation, layout = Simulation(scenario, 1), action_layout(scenario)
    begun = simulation.reset([5])
    whole, parts = Recorder(scenario, begun), StreamingRecorder(scenario, begun, (), 7)
    action = 0.6 - 1.2 * (layout.is_channel("clock")[None] > 0.0)
    for _ in range(scenario.horizon):
        transition = simulation.step(action)
        whole.add(transition)
        parts.add(transition)
    assert parts.metrics()[0] == pytest.approx(whole.metrics()[0], rel=1e-6, abs=1e-8)
