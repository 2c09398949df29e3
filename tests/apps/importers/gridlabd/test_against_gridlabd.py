"""Voltages of imported models against GridLAB-D's, whose output has six digits."""

import cmath
import math

import numpy as np
import pytest

from dcgrid_env import ThreePhaseFeeder
from dcgrid_env.apps.importers.gridlabd import read_gridlabd
from dcgrid_env.powerflow import solve_unbalanced
from helpers.gridlabd_text import VOLTAGES

pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")
CLOSE_PU = {"split phase": 1e-4}
"""Currents of triplex_load objects keep their angle in GridLAB-D and turn with the voltage here; others: 3e-5."""


@pytest.mark.parametrize("name", VOLTAGES)
@pytest.mark.slow
def test_voltages_are_gridlabds(name, model):
    text, expected = VOLTAGES[name]
    imported = read_gridlabd(model(text))
    feeder = ThreePhaseFeeder.from_network(imported.network)
    solution = solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    ours = dict(zip(feeder.node_ids, np.asarray(solution.v_re_pu) + 1j * np.asarray(solution.v_im_pu), strict=True))
    node = feeder.network.node
    base = {
        f"{bus}.{'abc'[phase - 1]}": 1e3 * kv
        for bus, phase, kv in zip(node.bus, node.phase, node.base_kv_ln, strict=True)
    }
    assert solution.converged
    for node_id, v in imported.v_pu.items():
        assert abs(v - ours[node_id]) < 1e-7
    for bus, volts in expected.items():
        for phase, (v, deg) in zip("abc", volts, strict=False):
            theirs = cmath.rect(v, math.radians(deg)) / base[f"{bus}.{phase}"]
            assert abs(theirs - ours[f"{bus}.{phase}"]) < CLOSE_PU.get(name, 3e-5), (bus, phase)
