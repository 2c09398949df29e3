"""A feeder with other switches: the published loss minimum of the 33-bus feeder, and what is refused."""

import numpy as np
import pytest

from dcgrid_env import FeederError, distflow, load_feeder, make_scenario
from dcgrid_env.grid.reconfigured import reconfigured


def test_the_loss_minimum_of_baran_and_wu():
    # 139.55 kW and 0.9378 p.u.: S. K. Goswami, S. K. Basu, IEEE Trans. Power Delivery 7(3), 1992.
    feeder, sensing = load_feeder("ieee33"), make_scenario("wrong-model").sensing
    switched = reconfigured(feeder, sensing.model_open, sensing.model_closed)
    assert set(switched.bus_ids) == set(feeder.bus_ids)
    assert switched.n_branch == 32
    assert switched.p_load_kw.sum() == pytest.approx(feeder.p_load_kw.sum())
    solution = distflow(switched, switched.p_load_kw[None], switched.q_load_kvar[None], 1.0)
    assert float(np.squeeze(solution.loss_kw)) == pytest.approx(139.55, abs=0.01)
    assert float(solution.v_pu.min()) == pytest.approx(0.9378, abs=1e-4)


def test_there_and_back_is_the_same_feeder():
    feeder = load_feeder("ieee33")
    k = feeder.branch_names.index("branch 6-7")
    away = reconfigured(feeder, [(6, 7)], [("12", "22", 2.0, 2.0)])
    back = reconfigured(away, [("22", "12")], [("6", "7", feeder.r_ohm[k], feeder.x_ohm[k])])
    positions = [back.index(bus) for bus in feeder.bus_ids]
    load = (feeder.p_load_kw[None], feeder.q_load_kvar[None])
    p_kw, q_kvar = (values[:, np.argsort(positions)] for values in load)
    v = distflow(back, p_kw, q_kvar, 1.0).v_pu[:, positions]
    np.testing.assert_allclose(v, distflow(feeder, *load, 1.0).v_pu, atol=1e-9)


@pytest.mark.parametrize(
    ("opened", "closed", "message"),
    [
        ([("6", "9")], [], "has no branch 6-9 to open; at bus 6 are 5-6, 6-7, 6-26"),
        ([("6", "99")], [], "has no bus '99'"),
        ([("6", "7"), ("7", "6")], [], "branch 7-6 is opened twice; name it once"),
        ([("6", "7")], [], "not connected to the substation '1'; add the missing branch"),
    ],
)
def test_refusals(opened, closed, message):
    with pytest.raises(FeederError, match=message):
        reconfigured(load_feeder("ieee33"), opened, closed)
