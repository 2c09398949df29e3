"""The law's second on tensors: the values of NumPy's, and the derivative of the implicit function."""

import numpy as np
import pytest
import torch

from dcgrid_env import field_names, make_scenario
from dcgrid_env.agents.algorithms.carry_over import LawGradient
from dcgrid_env.agents.policy.law_interface import Columns
from dcgrid_env.baselines.model_aided.commissioning import commission, site_of
from dcgrid_env.baselines.model_aided.knowledge import Law
from dcgrid_env.baselines.model_aided.law_step import LawStep, Past


def steps(preset, array, joint):
    scenario = make_scenario(preset)
    buses = [scenario.feeder.index(bus) for device in scenario.devices for bus in device.buses or ()]
    site = site_of(scenario, Law(floor_pu=0.003))  # smooth, so that differences are near derivatives
    columns = Columns(scenario, array)
    now, past = columns.physical(columns.of(joint)), Past()
    past.steps = 1  # the first begins elsewhere
    law = LawStep if array is np.asarray else LawGradient
    return law(site, commission(site, np.array([buses])), array)(now, past)


def double(array):
    return torch.from_numpy(np.array(array))


def observed(preset, deviations=(-1.2, -0.4)):
    """Observations of two environments somewhere within what voltages, powers and queues are."""
    scenario, rng = make_scenario(preset), np.random.default_rng(3)
    between = {"v_deviation": deviations, "p": (0.3, 0.8), "q": (-0.2, 0.9), "p_ref_next": (0.6, 1.0),
               "backlog": (0.5, 2.0)}  # fmt: skip
    names = [name for agent in scenario.agents for name in field_names(scenario)[agent]]
    ranges = np.array([between.get(name, (0.0, 0.0)) for name in names])
    low, high = ranges.T
    return rng.uniform(low, high, (2, len(names)))


@pytest.mark.parametrize("preset", ["ieee33-weak", "mixed"])
@pytest.mark.slow
def test_tensors_and_arrays_come_to_the_same(preset):
    joint = observed(preset)
    for ours, its in zip(steps(preset, np.asarray, joint), steps(preset, double, double(joint)), strict=True):
        np.testing.assert_allclose(its.numpy(), ours, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("preset", "deviations", "of"), [("ieee33-weak", (-1.2, -0.4), "cut_kw"), ("khodr141", (-0.4, 0.2), "chosen")]
)
@pytest.mark.slow
def test_the_derivative_is_that_of_the_decisions(preset, deviations, of):
    joint, apart = observed(preset, deviations), 5e-3  # of the band
    names = [name for own in field_names(make_scenario(preset)).values() for name in own]
    columns = [i for i, name in enumerate(names) if name == "v_deviation"]
    leaf = double(joint).requires_grad_()
    now = getattr(steps(preset, double, leaf), of)
    (slope,) = torch.autograd.grad(now.sum(), leaf)
    compared = 0
    for agent, column in zip(range(now.shape[1]), columns, strict=False):
        below, above = (joint.copy() for _ in range(2))
        below[:, column] -= apart
        above[:, column] += apart
        low, high = (getattr(steps(preset, np.asarray, there), of)[:, agent] for there in (below, above))
        left, right = (now[:, agent].detach().numpy() - low) / apart, (high - now[:, agent].detach().numpy()) / apart
        straight = (abs(left - right) < 0.2 * abs(left)) & (left != 0.0)  # elsewhere a limit or a kink is between
        expected = (high - low)[straight] / (2.0 * apart)
        np.testing.assert_allclose(slope[:, column].numpy()[straight], expected, rtol=0.1)
        compared += straight.sum()
    assert compared >= 2
