"""Steps of 0.1 s: every preset runs, and draws the energy that steps of 1 s draw."""

import numpy as np
import pytest

from dcgrid_env import LinearDvfs, PrefillDecodeDvfs, make_scenario
from dcgrid_env.baselines import Droop, NoControl, rollout
from dcgrid_env.traces import TRACE_SOURCES
from helpers.forms import FORMS


@pytest.mark.parametrize("preset", FORMS)
@pytest.mark.parametrize("law", [LinearDvfs, PrefillDecodeDvfs])
@pytest.mark.slow
def test_every_preset_runs(preset, law):
    scenario = make_scenario(preset, dt_s=0.1, horizon=150, datacenters={"clock_law": law(), "boost_share": 1.3})
    for controller in (NoControl(), Droop(5.0)):
        for metrics in rollout(scenario, controller, range(2)).metrics():
            assert all(map(np.isfinite, metrics.values()))
            assert metrics["power_flow_converged"]


ALIKE = ("llama3-405b", "mixtral-8x22b", "deepseek-v3")
"""Sources that are made as llama3-70b is."""


@pytest.mark.parametrize(
    "source",
    [
        pytest.param(source, marks=pytest.mark.slow) if source in ALIKE else source
        for source in TRACE_SOURCES
        if source not in ("chat", "site")
    ],
)
@pytest.mark.slow
def test_a_step_of_a_second_draws_the_mean_of_ten(source):
    # The window begins with the row, where step k covers the times from k dt to (k + 1) dt.
    same = {"trace": source, "workload.window": "start", "datacenters.clock_law": PrefillDecodeDvfs()}
    coarse, fine = (
        rollout(make_scenario("ieee33-weak", dt_s=dt_s, horizon=horizon, **same), NoControl(), [4]).series(0)
        for dt_s, horizon in ((1.0, 60), (0.1, 609))
    )
    tenths = fine.p_kw[9:, :3].reshape(60, 10, 3).mean(axis=1)
    np.testing.assert_allclose(coarse.p_kw[:, :3], tenths, rtol=1e-9)
