"""A scenario's fixed figures as arrays: what they are, and of which kind."""

import numpy as np
import pytest
import torch

from dcgrid_env import Feeder, make_scenario
from dcgrid_env.engine.physics.parameters import inverse, parameters


def test_figures_worked_by_hand():
    scenario = make_scenario(
        "ieee33-weak",
        datacenters={
            "p_rated_kw": (1000.0, 500.0, 200.0),
            "f_min_mhz": 200.0,
            "f_max_mhz": 1000.0,
            "idle_share": 0.25,
            "s_rated_share": 1.2,
            "q_max_share": 0.4,
        },
        inverters={"s_rated_kva": (10.0, 20.0, 30.0, 40.0)},
    )
    known = parameters(scenario, np.empty(0))
    np.testing.assert_allclose(known.middle, [600.0, 0.0] * 3 + [0.0] * 4)  # clock and reactive power, then inverters
    np.testing.assert_allclose(known.half_range, [400.0, 400.0, 400.0, 200.0, 400.0, 80.0, 10.0, 20.0, 30.0, 40.0])
    assert known.reactive.tolist() == [1, 3, 5, 6, 7, 8, 9]
    assert known.has_reactive is None
    (clock,), none = known.rest
    assert none == ()
    np.testing.assert_allclose(clock, [1000.0] * 3)
    np.testing.assert_allclose(known.p_scale_kw, [1000.0, 500.0, 200.0, 10.0, 20.0, 30.0, 40.0])
    np.testing.assert_allclose(known.q_scale_kvar, [400.0, 200.0, 80.0, 10.0, 20.0, 30.0, 40.0])
    np.testing.assert_allclose(known.converter_kva, [1200.0, 600.0, 240.0, 10.0, 20.0, 30.0, 40.0])
    assert known.p_all_kw == pytest.approx(1700.0 + scenario.feeder.p_load_kw.sum())
    np.testing.assert_allclose(known.devices[0].p_idle_kw, [250.0, 125.0, 50.0])
    np.testing.assert_allclose(known.devices[0].p_dynamic_kw, [750.0, 375.0, 150.0])
    np.testing.assert_allclose(known.devices[0].q_max_kvar, [400.0, 200.0, 80.0])


def test_inverses_of_any_size():
    assert inverse(np.array([0.0, 0.25, 1.0, 8.0])).tolist() == [0.0, 4.0, 1.0, 0.125]


def test_a_feeder_without_load_divides_nothing_by_zero():
    feeder = Feeder.from_tables(
        name="bare", base_kv=1.0, substation=0, v0_pu=1.0, bus_ids=[0, 1], p_load_kw=[0.0, 0.0],
        q_load_kvar=[0.0, 0.0], from_bus=[0], to_bus=[1], r_ohm=[0.1], x_ohm=[0.1],
    )  # fmt: skip
    bare = make_scenario("toy6", feeder=feeder, n_datacenters=0, datacenters={"buses": ()}, inverters={"buses": (1,)})
    assert parameters(bare, np.empty(0)).p_all_kw == 1.0


def test_no_datacenter_divides_nothing_by_zero():
    known = parameters(make_scenario("toy6", n_datacenters=0, datacenters={"buses": ()}), np.empty(0))
    assert known.middle.shape == (2,)
    assert known.rest[0][0].shape == (0,)
    np.testing.assert_allclose(known.q_scale_kvar, [1000.0, 1000.0])


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("kind", ["numpy", "torch"])
def test_kind_and_precision_are_those_asked_for(kind, precision):
    like = np.zeros(1, precision) if kind == "numpy" else torch.zeros(1, dtype=getattr(torch, precision))
    scenario = make_scenario("ieee33-weak")
    known = parameters(scenario, like)
    figures = [known.middle, known.half_range, known.rest[0][0], *known[6:-1]]
    for array in (*known.devices[0], *figures):
        assert type(array) is type(like)
        assert array.dtype == like.dtype
    assert known.p_all_kw == pytest.approx(3000.0 + 3715.0)
    assert parameters(scenario, like) is known  # made once
    reference = parameters(scenario, np.zeros(1))
    reference_figures = [reference.middle, reference.half_range, reference.rest[0][0], *reference[6:-1]]
    for a, b in zip(figures, reference_figures, strict=True):
        np.testing.assert_allclose(np.asarray(a), np.asarray(b), rtol=1e-6)


def test_writing_to_one_kind_leaves_the_scenario_alone():
    scenario = make_scenario("toy6")
    known = parameters(scenario, torch.zeros(1, dtype=torch.float64))
    before = scenario.datacenters.parameters.p_rated_kw.copy()
    known.devices[0].p_rated_kw.add_(1.0)
    np.testing.assert_array_equal(scenario.datacenters.parameters.p_rated_kw, before)
