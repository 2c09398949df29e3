"""What the tests of the three-phase power flow share: random inputs, and the two forms for tensors."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from dcgrid_env import ThreePhaseFeeder, load_feeder
from dcgrid_env.powerflow import Control, solve_unbalanced
from helpers.feeders import THREE_PHASE


class Inputs(NamedTuple):
    """Inputs of a power flow, of any kind of array."""

    p_kw: Any
    q_kvar: Any
    source_pu: Any
    ratio: Any
    state: Any


@pytest.fixture(params=THREE_PHASE)
def feeder(request) -> ThreePhaseFeeder:
    return load_feeder(request.param)


@pytest.fixture
def random_inputs():
    """Random loads, injections at some nodes, source voltages, taps and capacitors that every feeder can carry."""

    def draw(feeder: ThreePhaseFeeder, n_row: int, seed: int) -> Inputs:
        rng = np.random.default_rng(seed)
        p_kw = feeder.p_load_kw * rng.uniform(0.2, 1.2, (n_row, feeder.n_leg))
        q_kvar = feeder.q_load_kvar * rng.uniform(-0.2, 1.2, (n_row, feeder.n_leg))
        legs = feeder.first_device_leg + rng.integers(3, feeder.n_node, 8)
        p_kw[:, legs] += rng.uniform(-20.0, 20.0, (n_row, 8))
        q_kvar[:, legs] += rng.uniform(-20.0, 20.0, (n_row, 8))
        ratio = feeder.tap_ratio(rng.integers(-5, 8, (n_row, feeder.n_regulator)))
        state = rng.integers(0, 2, (n_row, feeder.n_capacitor)).astype(float)
        return Inputs(p_kw, q_kvar, rng.uniform(0.98, 1.03, n_row), ratio, state)

    return draw


@pytest.fixture
def solved():
    """Solve a batch of ``Inputs``."""

    def solve(feeder: ThreePhaseFeeder, inputs: Inputs, **options: Any):
        control = Control(tap_ratio=inputs.ratio, capacitor_on=inputs.state)
        return solve_unbalanced(feeder, *inputs[:3], control, **options)

    return solve
