"""Compiled kernels of a step give the bits of the array forms that tensors go through."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from dcgrid_env.engine.cost import reward
from dcgrid_env.engine.physics import step_kernels
from dcgrid_env.engine.physics.dynamics import net_loads
from dcgrid_env.engine.physics.voltage_figures import voltage_figures
from dcgrid_env.scenario.costs.grid_terms import voltage_cost
from dcgrid_env.scenario.presets import make_scenario

RNG = np.random.default_rng(0)
V_PU = RNG.normal(1.0, 0.06, (5, 33))


@pytest.mark.parametrize("kind", ["l1", "l2", "bowl", "courant_beltrami", "bump"])
def test_sums_over_voltages(kind):
    scenario = make_scenario("ieee33", cost={"voltage": kind})
    judged = reward.terms(scenario).judged
    figures = voltage_figures(V_PU, judged.start, scenario.cost.band_pu)

    def sums_of(v_pu, figures=None):
        state: Any = SimpleNamespace(v_pu=v_pu)
        step = reward._step(scenario, state, None, figures)
        return step.voltage_sum, step.excess_sum

    sums = sums_of(V_PU, figures)
    deviation = np.abs(V_PU[:, judged] - 1.0)
    np.testing.assert_array_equal(sums[0], voltage_cost(kind, deviation, scenario.cost.band_pu).sum(-1))
    np.testing.assert_array_equal(sums[1], np.maximum(deviation - scenario.cost.band_pu, 0.0).sum(-1))
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


def test_net_loads_keep_the_power_of_agents():
    nodes = np.array([[[0, 4, 4], [2, 3, 5]]])
    p_load, q_load, p, q = (RNG.normal(0, 50, (1, k)) for k in (6, 6, 2, 2))
    p_net, q_net = net_loads(p_load, q_load, nodes, p, q)
    np.testing.assert_allclose((p_net - p_load)[0], [p[0, 0] / 3, 0, *[p[0, 1] / 3] * 2, p[0, 0] / 1.5, p[0, 1] / 3])
    np.testing.assert_allclose((p_net - p_load).sum(-1), p.sum(-1))
    np.testing.assert_allclose((q_net - q_load).sum(-1), -q.sum(-1))
