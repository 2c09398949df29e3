"""The law's second on tensors: the values of NumPy's, and the derivative of the implicit function."""

import numpy as np
import pytest
import torch

from dcgrid_env import field_names, make_scenario
from dcgrid_env.agents.policy.law_step import Columns, LawStep, Past
from dcgrid_env.baselines.model_aided.commissioning import commission, site_of


def steps(preset, array, joint):
    scenario = make_scenario(preset)
    buses = [scenario.feeder.index(bus) for device in scenario.devices for bus in device.buses]
    site = site_of(scenario)
    columns = Columns(scenario, array)
    now, past = columns.own(columns.of(joint)), Past()
    past.steps = 1  # the first begins elsewhere
    return LawStep(site, commission(site, np.array([buses])), array)(now, past)


def double(array):
    return torch.from_numpy(np.array(array))


def observed(preset):
    """Observations of two lanes somewhere within what voltages, powers and queues are."""
    scenario, rng = make_scenario(preset), np.random.default_rng(3)
    between = {"v_deviation": (-1.2, -0.4), "p": (0.3, 0.8), "q": (-0.2, 0.9), "p_ref_next": (0.6, 1.0),
               "backlog": (0.5, 2.0)}  # fmt: skip
    names = [name for agent in scenario.agents for name in field_names(scenario)[agent]]
    ranges = np.array([between.get(name, (0.0, 0.0)) for name in names])
    return rng.uniform(*ranges.T, (2, len(names)))


@pytest.mark.parametrize("preset", ["ieee33-weak", "mixed"])
def test_tensors_and_arrays_come_to_the_same(preset):
    joint = observed(preset)
    for ours, its in zip(steps(preset, np.asarray, joint), steps(preset, double, double(joint)), strict=True):
        np.testing.assert_allclose(its.numpy(), ours, rtol=0, atol=1e-9)


def test_the_derivative_is_that_of_the_decisions():
    joint = observed("ieee33-weak")
    voltages = [i for i in range(joint.shape[1]) if abs(joint[0, i]) > 0.4 and joint[0, i] < 0.0]
    leaf = double(joint).requires_grad_()
    done = steps("ieee33-weak", double, leaf)
    assert (done.cut_kw > 0.0).any()
    assert (abs(done.chosen) < 0.99).any()
    apart = 5e-3  # of the band: above what the search leaves open
    for of in ("cut_kw", "chosen"):
        (slope,) = torch.autograd.grad(getattr(done, of).sum(), leaf, retain_graph=True)
        for i in voltages:
            moved = []
            for sign in (1.0, -1.0):
                there = joint.copy()
                there[:, i] += sign * apart
                moved.append(getattr(steps("ieee33-weak", np.asarray, there), of).sum())
            by_difference = (moved[0] - moved[1]) / (2.0 * apart)
            assert float(slope[:, i].sum()) == pytest.approx(by_difference, rel=0.1, abs=0.05)
