"""DistFlow against pandapower's Newton method: 9 random loads on each named feeder, a third of them feeding back."""

import numpy as np
import pytest

from dcgrid_env import distflow

N_ROW = 9


@pytest.mark.slow
def test_distflow_agrees_with_newton_in_pandapower(feeder, random_loads, pandapower_net):
    p_kw, q_kvar, v0_pu = random_loads(feeder, N_ROW, seed=1)
    solution = distflow(feeder, p_kw, q_kvar, v0_pu)
    assert solution.converged.all()
    first = feeder.parent == 0
    p_import = solution.p_branch_kw[:, first].sum(axis=-1) + p_kw[:, 0]
    q_import = solution.q_branch_kvar[:, first].sum(axis=-1) + q_kvar[:, 0]
    assert (solution.p_branch_kw < 0).any(axis=-1).sum() >= N_ROW // 3  # power does flow back
    net = pandapower_net(feeder)
    for row in range(N_ROW):
        newton = net.solve(p_kw[row], q_kvar[row], v0_pu[row])
        assert newton["v_pu"].min() < 0.9999 * v0_pu[row] or newton["v_pu"].max() > 1.0001 * v0_pu[row]
        np.testing.assert_allclose(solution.v_pu[row], newton["v_pu"], rtol=0.0, atol=1e-7)
        np.testing.assert_allclose(solution.loss_kw[row], newton["loss_kw"], rtol=0.0, atol=1e-3)
        np.testing.assert_allclose(p_import[row], newton["p_import_kw"], rtol=0.0, atol=1e-2)
        np.testing.assert_allclose(q_import[row], newton["q_import_kvar"], rtol=0.0, atol=1e-2)


@pytest.mark.slow
def test_distflow_agrees_close_to_collapse(feeder, pandapower_net):
    # A load scaled up to a lowest voltage of 0.7 p.u. or less: far beyond operation, where the loss terms dominate.
    net = pandapower_net(feeder)
    scale = {"toy6": 13.0, "ieee33": 3.0, "das69": 2.8, "ieee123": 2.2, "khodr141": 3.5}[feeder.name]
    p_kw, q_kvar = scale * feeder.p_load_kw, scale * feeder.q_load_kvar
    newton = net.solve(p_kw, q_kvar, 1.0)
    solution = distflow(feeder, p_kw, q_kvar, 1.0)
    assert newton["v_pu"].min() < 0.7
    assert solution.converged
    np.testing.assert_allclose(solution.v_pu, newton["v_pu"], rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(solution.loss_kw, newton["loss_kw"], rtol=1e-5)
