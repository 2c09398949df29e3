"""The compiled interval of sites under the linear clock law gives the bits of the array form."""

import numpy as np
import pytest
import torch

from dcgrid_env.devices.datacenter import datacenter
from dcgrid_env.devices.datacenter.clock_law import LinearDvfs
from dcgrid_env.devices.ratings import DataCenterParams


@pytest.mark.parametrize("boost", [False, True])
def test_bits_of_the_array_form(boost):
    rng, slots = np.random.default_rng(0), 4
    rated = rng.uniform(100.0, 900.0, slots)
    one = np.ones(slots)
    params = DataCenterParams(rated, 0.23 * rated, 0.77 * rated, 210.0 * one, 1410.0 * one, 1.1 * rated, 0.3 * rated)
    backlog = rng.uniform(-200.0, 900.0, (50, slots)).clip(0.0)
    p_ref, f_mhz = rng.uniform(0.0, 1.2, (50, slots)) * rated, rng.uniform(210.0, 1410.0, (50, 2 * slots))[:, ::2]
    f_mhz[:9] = 1410.0
    ours = datacenter.step(params, LinearDvfs(), backlog, p_ref, f_mhz, 0.7, boost=boost)
    on_torch = DataCenterParams(*(torch.tensor(a) for a in params))
    queued, drawn, clock = (torch.tensor(a) for a in (backlog, p_ref, f_mhz.copy()))
    theirs = datacenter.step(on_torch, LinearDvfs(), queued, drawn, clock, 0.7, boost=boost)
    for mine, other in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(mine, other.numpy())
    assert (ours.backlog_kws == 0.0).any()
    assert ours.class_served_kw is ours.served_kw
