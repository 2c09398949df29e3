"""Compiled kernels of a step give the bits of the array forms that tensors go through."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from dcgrid_env.core.arrays import is_rows
from dcgrid_env.engine.cost import reward
from dcgrid_env.engine.physics import step_kernels
from dcgrid_env.engine.physics.dynamics import _net_loads
from dcgrid_env.engine.physics.state import Exogenous
from dcgrid_env.engine.physics.voltage_figures import voltage_figures
from dcgrid_env.scenario.costs.grid_terms import voltage_cost
from dcgrid_env.scenario.presets import make_scenario

RNG = np.random.default_rng(0)
V_PU = RNG.normal(1.0, 0.06, (5, 33))


@pytest.mark.parametrize("kind", ["l1", "l2", "bowl", "courant_beltrami", "bump"])
def test_sums_over_voltages(kind):
    scenario = make_scenario("ieee33", voltage_cost=kind)
    judged = reward.terms(scenario).judged
    figures = voltage_figures(V_PU, judged.start, scenario.band_pu)

    def sums_of(v_pu, figures=None):
        state: Any = SimpleNamespace(v_pu=v_pu)
        step = reward._step(scenario, state, None, figures)
        return step.voltage_sum, step.excess_sum

    sums = sums_of(V_PU, figures)
    deviation = np.abs(V_PU[:, judged] - 1.0)
    np.testing.assert_array_equal(sums[0], voltage_cost(kind, deviation, scenario.band_pu).sum(-1))
    np.testing.assert_array_equal(sums[1], np.maximum(deviation - scenario.band_pu, 0.0).sum(-1))
    tensors = sums_of(torch.tensor(V_PU))
    for ours, theirs in zip(sums, tensors, strict=True):
        np.testing.assert_allclose(ours, theirs.numpy(), rtol=1e-14)


def test_joint_observation():
    raw, scale, high = (
        RNG.normal(0.0, 2.0, (4, 5)),
        RNG.uniform(0.1, 3.0, 5),
        np.linspace(0.1, 1.0, 7, dtype=np.float32),
    )
    column = np.array([0, 3, 1, 1, 4, 2, 0])
    cut = step_kernels.joint_observation(raw, scale, column, -high, high)
    assert cut.dtype == np.float32
    whole = (raw * scale)[:, column].astype(np.float32)
    np.testing.assert_array_equal(cut, np.minimum(np.maximum(whole, -high), high))


def test_setpoints():
    action = np.concatenate((RNG.uniform(-2.0, 2.0, (3, 4)), [[-1.0, 1.0, 0.0, np.nan]]))
    middle, half = RNG.uniform(0.0, 800.0, 4), RNG.uniform(0.0, 600.0, 4)
    expected = middle + half * np.minimum(np.maximum(action, -1.0), 1.0)
    np.testing.assert_array_equal(step_kernels.setpoints(action, middle, half), expected)


@pytest.mark.parametrize("parts", [1, 3])
def test_net_loads(parts):
    lanes, n, agents = 3, 12, 4
    at = np.stack([RNG.permutation(n)[: agents * parts].reshape(agents, parts) for _ in range(lanes)])
    nodes = at + n * np.arange(lanes)[:, None, None]
    p_load, q_load, p, q = (RNG.normal(0, 50, (lanes, k)) for k in (n, n, agents, agents))
    outside = Exogenous(p_load, q_load, p[:, :1], p[:, :1], nodes)
    ours = _net_loads(outside, p, q)
    tensors = [torch.tensor(x) for x in (p_load, q_load, p[:, :1], p[:, :1], nodes)]
    as_tensors = Exogenous(tensors[0], tensors[1], tensors[2], tensors[3], tensors[4])
    theirs = _net_loads(as_tensors, torch.tensor(p), torch.tensor(q))
    for mine, other in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(mine, other.numpy())
    np.testing.assert_allclose(ours[0].sum(-1), p_load.sum(-1) + p.sum(-1))
    np.testing.assert_allclose(ours[1].sum(-1), q_load.sum(-1) - q.sum(-1))


def test_what_kernels_take():
    assert is_rows(V_PU)
    for other in (V_PU[0], V_PU.astype(np.float32), V_PU[:, ::2], V_PU.tolist(), torch.tensor(V_PU)):
        assert not is_rows(other)
