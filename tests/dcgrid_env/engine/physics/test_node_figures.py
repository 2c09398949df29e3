"""Figures that a step takes of a three-phase power flow: the compiled form gives the bits of the array forms."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env.engine.physics.node_figures import from_nodes, node_extremes, phase_figures
from dcgrid_env.engine.physics.voltage_figures import voltage_figures
from dcgrid_env.powerflow import ThreePhaseSolution, branch_loading, has_ratings, three_phase_nodes, unbalance_factor
from dcgrid_env.scenario.presets import make_scenario

ROWS, SLOTS = 5, 4


@pytest.mark.parametrize("preset", ["ieee123-3ph", "ieee13-3ph", "ieee34-3ph"])
@pytest.mark.parametrize("parts", [1, 6])
def test_bits_of_the_array_forms(preset, parts):
    scenario, rng = make_scenario(preset), np.random.default_rng(parts)
    feeder: Any = scenario.feeder
    n = feeder.n_node
    re, im = rng.normal(0.0, 0.8, (2, ROWS, n))
    i_re, i_im = rng.normal(0.0, 300.0, (2, ROWS, n))
    solution: Any = ThreePhaseSolution(np.hypot(re, im), re, im, i_re, i_im, *[None] * 7)
    nodes = rng.integers(0, n, (ROWS, SLOTS, parts)) + n * np.arange(ROWS)[:, None, None]
    figures = phase_figures(scenario, solution, nodes)
    expected = [
        from_nodes(solution.v_pu, nodes),
        *node_extremes(solution.v_pu, nodes),
        unbalance_factor(three_phase_nodes(feeder), re, im),
        branch_loading(feeder, solution),
        *voltage_figures(solution.v_pu, feeder.load_slice.start, scenario.cost.band_pu),
    ]
    loading = figures.loading if has_ratings(feeder) else np.zeros((ROWS, n))
    assert figures.voltages is not None
    for ours, theirs in zip((*figures[:4], loading, *figures.voltages), expected, strict=True):
        np.testing.assert_array_equal(ours, theirs)
