"""The sweep against OpenDSS's published solutions of the IEEE 13, 34 and 123 node feeders."""

import numpy as np
import pytest

from dcgrid_env.powerflow import Control, branch_flows, solve_unbalanced
from helpers.feeders import THREE_PHASE
from helpers.opendss_points import POINTS, published_point

V_PU, ANGLE_DEG, KW, AMPERE = 1e-6, 1e-4, 1e-2, 1e-3


def turned(angle_deg):
    return (angle_deg + 180.0) % 360.0 - 180.0


@pytest.mark.parametrize("name", THREE_PHASE)
@pytest.mark.parametrize("point", POINTS)
def test_voltages_losses_and_source_power(name, point):
    at = published_point(name, point)
    control = Control(tap_ratio=at.feeder.tap_ratio(at.tap))
    solution = solve_unbalanced(at.feeder, at.p_kw, at.q_kvar, control=control)
    assert solution.converged
    np.testing.assert_allclose(solution.v_pu, at.v_pu, rtol=0.0, atol=V_PU)
    assert np.abs(turned(solution.v_angle_deg - at.angle_deg)).max() < ANGLE_DEG
    assert solution.loss_kw == pytest.approx(at.totals["loss_kw"], abs=KW)
    assert solution.source_p_kw == pytest.approx(at.totals["source_p_kw"], abs=KW)
    assert solution.source_q_kvar == pytest.approx(at.totals["source_q_kvar"], abs=KW)


@pytest.mark.parametrize("name", THREE_PHASE)
def test_currents_and_power_into_the_branches(name):
    at = published_point(name, "nominal")
    solution = solve_unbalanced(at.feeder, at.p_kw, at.q_kvar)
    flows, feeder = branch_flows(at.feeder, solution), at.feeder
    checked = 0
    for row in at.flows:
        k = feeder.index(row["to_bus"]) - 1
        phases = feeder.bus_phases[k + 1]
        if feeder.bus_ids[feeder.parent[k]] != row["from_bus"]:
            continue  # a line that is written from its far end
        i = phases.index(row["phase"])
        angle_deg = np.rad2deg(np.angle(flows.current_a[k, i]))
        assert abs(flows.current_a[k, i]) == pytest.approx(float(row["i_from_a"]), abs=AMPERE)
        if float(row["i_from_a"]) > 1.0:
            assert abs(turned(angle_deg - float(row["i_from_angle_deg"]))) < 1e-2
        assert flows.p_kw[k, i] == pytest.approx(float(row["p_from_kw"]), abs=KW)
        assert flows.q_kvar[k, i] == pytest.approx(float(row["q_from_kvar"]), abs=KW)
        checked += 1
    assert checked > 0.9 * (feeder.n_node - 3)
