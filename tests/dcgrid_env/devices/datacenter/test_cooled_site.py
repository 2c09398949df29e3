"""Cooling of a site, worked by hand: the lag, its mean over an interval, and the figures of an episode."""

import math
from typing import Any

import numpy as np
import pytest

from dcgrid_env import Cooling, DataCenters
from dcgrid_env.devices.datacenter.cooled_site import CooledSite, CoolingState

GIVEN: dict[str, Any] = {"p_rated_kw": 100.0, "s_rated_share": 1.1, "q_max_share": 0.3}
NO_SITES: Any = None
PARAMS = DataCenters(count=1, **GIVEN).parameters
RULE = Cooling(cooling_share=0.4, time_constant_s=10.0, auxiliary_share=0.1)


def stepped(state, p_kw, dt_s, rule=RULE):
    """Cooling power over and at the end of an interval, and the draw of the site, kW."""
    site: Any = "site"
    given: Any = None
    after, unchanged, drawn = CooledSite(rule, 1.0).step(PARAMS, state, site, np.array([[p_kw]]), (), given, dt_s)
    assert unchanged == "site"
    assert after.computing_kw.item() == p_kw
    assert after.auxiliary_kw.item() == pytest.approx(10.0)
    assert drawn.item() == pytest.approx(p_kw + after.cooling_kw.item() + 10.0)
    return after


def test_cooling_has_settled_at_first_and_then_lags():
    begun = CooledSite(RULE, 1.0).initial(PARAMS, np.zeros((1, 1)))
    first = stepped(begun, 50.0, 5.0)
    assert (first.cooling_kw.item(), first.cooling_end_kw.item()) == (pytest.approx(20.0), pytest.approx(20.0))
    left = math.exp(-0.5)
    later = stepped(first, 100.0, 5.0)
    assert later.cooling_end_kw.item() == pytest.approx(40.0 - 20.0 * left)
    assert later.cooling_kw.item() == pytest.approx(40.0 - 20.0 * (1.0 - left) / 0.5)


def test_two_short_intervals_are_a_long_one_and_no_lag_follows_at_once():
    begun = stepped(CooledSite(RULE, 1.0).initial(PARAMS, np.zeros((1, 1))), 50.0, 1.0)
    half = stepped(begun, 100.0, 3.0)
    both, whole = stepped(half, 100.0, 3.0), stepped(begun, 100.0, 6.0)
    assert both.cooling_end_kw.item() == pytest.approx(whole.cooling_end_kw.item())
    assert (half.cooling_kw + both.cooling_kw).item() / 2.0 == pytest.approx(whole.cooling_kw.item())
    at_once = stepped(begun, 100.0, 1.0, Cooling(cooling_share=0.4, time_constant_s=0.0, auxiliary_share=0.1))
    assert (at_once.cooling_kw.item(), at_once.cooling_end_kw.item()) == (pytest.approx(40.0), pytest.approx(40.0))


def test_figures_of_an_episode_count_its_steps_and_not_its_beginning():
    computing, cooling, rest = (np.array([[first], [a], [b]]) for first, a, b in ((9, 50, 150), (9, 10, 30), (9, 4, 6)))
    history, sites = CoolingState(computing, cooling, cooling, rest), NO_SITES
    figures = CooledSite(RULE, 1.0).metrics(PARAMS, sites, history, 1800.0)
    assert figures == pytest.approx({"cooling_kwh": 20.0, "pue": 250.0 / 200.0})
    idle = CoolingState(0.0 * computing, cooling, cooling, rest)
    assert CooledSite(RULE, 1.0).metrics(PARAMS, sites, idle, 1800.0)["pue"] == 1.0


def test_a_site_that_is_supplied_in_part_draws_a_part():
    state = CoolingState(*(np.array([[value]]) for value in (50.0, 20.0, 18.0, 10.0)))
    supplied = CooledSite(RULE, 1.0).with_supply(state, np.array([[0.5]]))
    assert [field.item() for field in supplied] == [25.0, 10.0, 18.0, 5.0]
    assert CooledSite(RULE, 1.0).totals(state)["cooling_kw"].tolist() == [20.0]
    (observed,) = CooledSite(RULE, 1.0).observe(PARAMS, state)
    assert observed.item() == 18.0


@pytest.mark.parametrize(("share", "highest"), [(0.4, 0.48), (0.0, 1.0)])
def test_field_and_ratings(share, highest):
    rule = Cooling(cooling_share=share, auxiliary_share=0.1)
    (field,) = CooledSite(rule, 1.2).fields(PARAMS, 10, 1.0)
    assert (field.name, field.lowest, field.highest) == ("cooling", 0.0, pytest.approx(highest))
    np.testing.assert_array_equal(field.share_of, [100.0])
    assert rule.pue_at_rating == pytest.approx(1.1 + share)
    assert rule.largest_draw_share(1.2) == pytest.approx(1.2 * (1.0 + share) + 0.1)
    with pytest.raises(ValueError, match="cooling charges nothing, and so no 'x'"):
        CooledSite(rule, 1.2).amount("x", PARAMS, NO_SITES)
