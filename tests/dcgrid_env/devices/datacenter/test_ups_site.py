"""Sites behind a UPS: channels, fields and cost terms, and figures of an episode worked by hand."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import Cooling, DataCenters, UpsRideThrough
from dcgrid_env.devices.datacenter.ups_site import UpsSite, UpsState
from dcgrid_env.devices.ride_through import connection
from dcgrid_env.devices.ride_through.ups_battery import BatteryState

GIVEN: dict[str, Any] = {"p_rated_kw": (100.0, 300.0), "s_rated_share": 1.1, "q_max_share": 0.3}
PARAMS = DataCenters(count=2, **GIVEN).parameters
RULE = UpsRideThrough(
    curve="itic", release="agent", walk_in_s=5.0, battery_s=20.0, by_hand_s=40.0, stagger_s=10.0, lockout_events=4,
    returns_per_minute=2, trip_weight=2.0, away_weight=0.5, missing_weight=7.0,
)  # fmt: skip
SITE, COOLED = UpsSite(RULE), UpsSite(RULE, Cooling(cooling_share=0.4, auxiliary_share=0.1))


def test_an_agent_returns_within_the_shortest_ramp():
    (channel,) = SITE.channels(PARAMS)
    np.testing.assert_allclose([channel.lowest, channel.highest, channel.rest], [[-0.2] * 2, [0.2] * 2, [0.2] * 2])
    assert UpsSite(UpsRideThrough(curve="itic")).channels(PARAMS) == ()


def test_fields_are_shares_of_their_largest_values():
    found = {field.name: field.share_of.tolist() for field in SITE.fields(PARAMS, 10, 1.0)}
    assert found == {
        "ups_share": [1.0, 1.0],
        "ups_locked": [1.0, 1.0],
        "ups_events": [4.0, 4.0],
        "ups_returns": [2.0, 2.0],
        "ups_timer": [1.0, 1.0],
        "ups_wait": [50.0, 50.0],
        "ups_stored": [1.0, 1.0],
    }
    assert all((field.lowest, field.highest) == (0.0, 1.0) for field in SITE.fields(PARAMS, 10, 1.0))
    none = UpsRideThrough(
        curve="itic", lockout_events=0, returns_per_minute=0, return_delay_s=0.0, by_hand_s=0.0, stagger_s=0.0
    )
    _, _, events, returns, _, wait, _ = UpsSite(none).fields(PARAMS, 10, 1.0)
    assert [field.share_of[0] for field in (events, returns, wait)] == [1.0, 1.0, 1e-9]


@pytest.mark.parametrize(("site", "energy_s"), [(SITE, 20.0), (COOLED, 30.0)])
def test_cost_terms_and_amounts(site, energy_s):
    trips, away, recharge = site.cost_terms(PARAMS, 10, 1.0)
    assert (trips.team_scale, trips.largest, trips.weight, trips.is_constraint) == (2.0, 1.0, 2.0, True)
    assert (away.team_scale, away.largest, away.weight, away.is_constraint) == (2.0, 1.0, 0.5, False)
    assert (recharge.team_scale, recharge.weight, recharge.at_end) == (400.0, 7.0, True)
    assert recharge.largest == pytest.approx(energy_s)
    assert not trips.at_end
    assert not away.at_end
    np.testing.assert_array_equal(recharge.own_scale, [100.0, 300.0])
    state = site.initial(PARAMS, np.zeros((1, 2)))
    np.testing.assert_allclose(state.battery.stored_kws, [[100.0 * energy_s, 300.0 * energy_s]])
    ups = state.ups._replace(share=np.array([[0.25, 1.0]]), tripped=np.array([[0.0, 1.0]]))
    battery = state.battery._replace(stored_kws=state.battery.stored_kws - np.array([[5.0, 30.0]]))
    state = UpsState(ups, battery)
    np.testing.assert_allclose(site.amount("missing_kws", PARAMS, state), [[5.0, 30.0]])
    np.testing.assert_allclose(site.amount("away", PARAMS, state), [[0.75, 0.0]])
    np.testing.assert_allclose(site.amount("tripped", PARAMS, state), [[0.0, 1.0]])
    np.testing.assert_allclose(site.observe(PARAMS, state)[-1], [[1.0 - 0.05 / energy_s, 1.0 - 0.1 / energy_s]])


def test_what_grid_and_battery_supply():
    state = SITE.initial(PARAMS, np.zeros((1, 2)))
    ups = state.ups._replace(share=np.array([[0.5, 0.0]]))
    battery = state.battery._replace(battery_kw=np.array([[10.0, 30.0]]))
    state = UpsState(ups, battery)
    np.testing.assert_allclose(SITE.supplied(state, np.array([[40.0, 60.0]])), [[0.75, 0.5]])
    np.testing.assert_allclose(SITE.supplied(state, np.array([[10.0, 0.0]])), [[1.0, 1.0]])


def history() -> Any:
    """Two sites over a beginning and four steps of 0.5 s."""
    state = connection.initial(RULE, np.zeros((5, 2)))
    share = np.array([[0.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.4, 0.0], [1.0, 1.0]])
    tripped = np.array([[9.0, 9.0], [0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    ups = state._replace(share=share, tripped=tripped, lost_kw=tripped * [80.0, 200.0], locked=(share == 0.0) * 1.0)
    stored = np.array([[2000.0, 6000.0]] * 4 + [[1900.0, 6100.0]])
    battery_kw = (1.0 - share) * [80.0, 200.0]
    return UpsState(ups, BatteryState(stored, battery_kw, 0.0 * share, 0.5 * battery_kw))


def cut(state: Any, begin: int, end: int) -> Any:
    """Some of the states of a history."""
    return UpsState(*(fields._make(figures[begin:end] for figures in fields) for fields in state))


@pytest.mark.parametrize("parts", [[4], [2, 2], [1, 3]])
def test_figures_of_an_episode_in_parts_worked_by_hand(parts):
    sites: Any = None
    whole, at = SITE.streaming(PARAMS, 0.5), 0
    state = history()
    for steps in parts:
        whole.add(sites, cut(state, at, at + steps + 1))
        at += steps
    assert whole.figures() == pytest.approx(
        {
            "ups_trips": 2.0,
            "ups_lost_kw": 280.0,
            "ups_lost_step_kw": 200.0,
            "ups_away_s": 0.5 * (1.0 + 0.6 + 1.0),
            "ups_locked_s": 1.0,
            "ups_all_back_s": 1.0,
            "battery_work_kws": 0.25 * (80.0 + 48.0 + 200.0),
            "battery_energy_kws": 0.5 * (80.0 + 48.0 + 200.0),
            "battery_missing_kws": 100.0,
        }
    )
    totals = SITE.totals(cut(state, 2, 3))
    assert {name: value.item() for name, value in totals.items()} == {
        "ups_trips": 1.0,
        "ups_lost_kw": 80.0,
        "ups_away": 1.0,
        "ups_locked": 1.0,
        "battery_kw": 80.0,
    }
