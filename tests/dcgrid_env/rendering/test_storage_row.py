"""The figure of a run shows what storages hold."""

import numpy as np

from dcgrid_env import make_scenario
from dcgrid_env.baselines import make_controller, rollout
from dcgrid_env.rendering import run_figure
from helpers.storages import toy6_storage


def test_storages_have_a_row_of_their_own_with_a_curve_each():
    scenario = toy6_storage(6)
    run = rollout(scenario, make_controller("peak-shaving"), [0]).lane(0)
    axes = run_figure(scenario, {"peak-shaving": run}, 0).axes
    assert [ax.get_ylabel() for ax in axes] == ["voltage (p.u.)", "stored (%)", "GPU clock (MHz)", "backlog (kW s)"]
    curves = [np.asarray(line.get_ydata()) for line in axes[1].get_lines()]
    np.testing.assert_allclose(np.array(curves).T, run.stored_kwh / 5.0 * 100.0)


def test_without_storages_there_is_no_such_row():
    scenario = make_scenario("toy6", horizon=4)
    run = rollout(scenario, make_controller("none"), [0]).lane(0)
    assert len(run_figure(scenario, {"none": run}, 0).axes) == 3
