"""Hindsight with storages: the program against the environment, and its energy against theirs."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import Fault, Storages, forecast, make_scenario
from dcgrid_env.baselines import make_controller, rollout
from dcgrid_env.baselines.model_based.episode_program import EpisodeProgram
from dcgrid_env.baselines.model_based.hindsight import hindsight, replay
from helpers.storages import FIGURES, ieee33_weak_ups
from helpers.three_phase import ieee13


@pytest.fixture(scope="module")
def solved():
    scenario = ieee33_weak_ups(trace="inference", split="validation", horizon=60)
    return scenario, {seed: hindsight(scenario, seed) for seed in (0, 5)}


@pytest.mark.slow
def test_the_environment_agrees_with_the_program(solved):
    scenario, found = solved
    for seed, best in found.items():
        assert abs(best.gap) < 1e-4 * best.J
        assert replay(scenario, best.actions, seed).metrics()[0]["J"] == best.J
        assert np.abs(best.recorder.series(0).storage_kw).max() > 50.0


@pytest.mark.slow
def test_nothing_beats_hindsight_and_storage_is_worth_something(solved):
    scenario, found = solved
    without = make_scenario("ieee33-weak", split="validation", horizon=60)
    for name in ("none", "droop", "constant-q"):
        costs = rollout(scenario, make_controller(name), list(found)).costs()
        assert all(cost > best.J for cost, best in zip(costs, found.values(), strict=True))
    for seed, best in found.items():
        assert best.bound < hindsight(without, seed).bound


@pytest.mark.slow
def test_the_programs_energy_is_the_environments():
    figures: Any = FIGURES | {
        "energy_kwh": 0.4,
        "standby_share_per_h": 0.3,
        "ageing_price": 0.0,
        "discharge_efficiency": 0.9,
    }
    base = make_scenario("bursty", split="validation")
    storages = Storages(buses=(18, 33), **figures)
    scenario = base.replace(name="small", devices=(*base.devices, storages))
    program = EpisodeProgram(scenario, forecast(scenario, 1), keep_band=False)
    program.solve()
    _, actions = program.solve()
    series = replay(scenario, actions, 1).series(0)
    np.testing.assert_allclose(series.storage_kw, program.storage_kw, atol=1e-3)
    assert series.stored_kwh[1:].min() < 1e-6  # run empty on the way
    assert program.storage_kw.min() < -10.0
    assert series.metrics()["storage_missing_kwh"] == pytest.approx(0.0, abs=1e-4)


def test_a_share_of_the_way_is_a_course_of_its_own():
    scenario = ieee33_weak_ups(split="validation", horizon=10)
    program = EpisodeProgram(scenario, forecast(scenario, 0), keep_band=False)
    program.solve()
    first = program.storage_kw
    program.solve()
    second = program.storage_kw
    program.go(0.25)
    np.testing.assert_allclose(program.storage_kw, 0.75 * first + 0.25 * second)
    program.go(1.0)
    np.testing.assert_array_equal(program.storage_kw, second)


def test_a_storage_that_is_lost_is_not_counted_on():
    lost = Fault(("sto_0",), begin_s=(2.0, 2.0))
    scenario = ieee33_weak_ups(split="validation", horizon=20, faults=(lost,))
    best = hindsight(scenario, 0)
    drawn = best.recorder.series(0).storage_kw
    assert not drawn[2:, 0].any()
    assert np.abs(drawn[2:, 1:]).max() > 10.0
    assert abs(best.gap) < 2e-4 * best.J


@pytest.mark.slow
def test_a_storage_on_one_phase_of_a_three_phase_feeder():
    base = ieee13().replace(horizon=10, grid_control={"regulators": "fixed"}, split="validation")
    storages = Storages(buses=("692", "671"), phases=("c", "abc"), s_rated_kva=320.0, **FIGURES)
    scenario = base.replace(name="storage", devices=(*base.devices, storages))
    best = hindsight(scenario, 0)
    assert abs(best.gap) < 1e-3 * best.J
    assert hindsight(base, 0).bound > best.J


def test_storages_beside_equipment_that_is_agents_are_refused():
    base = ieee13().replace(grid_control={"regulators": "agent"})
    scenario = base.replace(name="both", devices=(*base.devices, Storages(buses=("692",), **FIGURES)))
    with pytest.raises(ValueError, match="hindsight is made for data centres, inverters and storage alone"):
        hindsight(scenario, 0)
