"""What each lever does, against R and X and against cases worked by hand."""

import pytest

from dcgrid_env import sensitivity
from dcgrid_env.apps.reproduction import bus13, levers
from dcgrid_env.apps.reproduction.load import choose_load
from dcgrid_env.apps.reproduction.paper import PUBLISHED_BUSES
from dcgrid_env.apps.reproduction.study_runs import Setting


def test_settled_is_the_power_flow_by_hand(few):
    scenario = few.setting.published(5)
    feeder = scenario.feeder
    r, x = sensitivity(feeder)
    at = feeder.index(13)
    before = levers.settled(scenario)
    more = levers.settled(scenario, {13: 10.0}, {13: 20.0})
    # Near 1 p.u. the exact drop is that of R and X, but for the loss that comes with it.
    assert before[at] - more[at] == pytest.approx(r[at, at] * 0.01 - x[at, at] * 0.02, abs=1e-5)
    assert before[0] == scenario.source_voltage_pu


@pytest.mark.slow
def test_near_and_far_inverters(few):
    records = levers.inverters(few)
    assert [r["site"] for r in records] == list(PUBLISHED_BUSES)
    for r in records:
        assert r["far_x_pu_per_mvar"] < r["near_x_pu_per_mvar"] <= r["own_x_pu_per_mvar"]
        for which in ("own", "near", "far"):
            # 1 Mvar by the exact power flow and by X agree to a tenth.
            assert r[f"{which}_rise_pu_per_mvar"] == pytest.approx(r[f"{which}_x_pu_per_mvar"], rel=0.1)
    site = {r["site"]: r for r in records}
    assert (site[53]["near_bus"], site[99]["near_bus"]) == (54, 103)


def test_bus_thirteen(few):
    found = bus13.bus_thirteen(few)
    five = few.setting.published(5)
    full = dict.fromkeys(PUBLISHED_BUSES[:5], 280.0)
    at = five.feeder.index(13)
    whole = found["base_pu"] - found["drop_own_pu"] - found["drop_neighbours_pu"]
    assert levers.settled(five, full)[at] == pytest.approx(whole, abs=1e-12)
    edge = full | {13: found["leaves_band_kw"]}
    assert levers.settled(five, edge)[at] < 0.95
    assert levers.settled(five, edge | {13: found["leaves_band_kw"] - 2.0})[at] > 0.95
    assert found["base_at_1pu_squared"] == pytest.approx(found["base_at_1pu"] ** 2)


def test_published_placement():
    setting = Setting(choose_load("generated"), episodes=2, placement="published")
    assert setting.counts == (1, 2, 3, 4, 5, 8)
    for n in setting.counts:
        assert setting.scenario(n).datacenters.buses == tuple(map(str, PUBLISHED_BUSES[:n]))
    assert Setting(choose_load("generated"), episodes=2).scenario(5).datacenters.buses is None


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"episodes": 1}, "episodes is 1; give at least 2"),
        ({"placement": "best"}, "placement is 'best'; choose one"),
    ],
)
def test_settings_that_cannot_be(wrong, message):
    with pytest.raises(ValueError, match=message):
        Setting(choose_load("generated"), **wrong)
