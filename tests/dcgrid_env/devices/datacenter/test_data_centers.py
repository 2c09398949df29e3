"""Groups of data centres: groups without a site, and the order of the features."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import DataCenters

FEATURES: dict[str, Any] = {
    "routing": {},
    "batching": {},
    "smoothing": {"control": "agent"},
    "cooling": {},
    "ride_through": {"curve": "itic", "release": "agent"},
    "service": {},
}
STORAGE: dict[str, Any] = {"storage": {"p_rated_kw": 300.0, "energy_kwh": 5.0}}
RATINGS: dict[str, Any] = {"p_rated_kw": 100.0, "s_rated_share": 1.1, "q_max_share": 0.3}


def group(count: int, **fields: Any) -> Any:
    """Sites with these features and other fields."""
    return DataCenters(count=count, **RATINGS, **fields)


@pytest.mark.parametrize("features", [FEATURES, STORAGE], ids=["all but storage", "storage"])
def test_shares_of_a_group_without_a_site_are_divided_by_one(features):
    sites = group(0, buses=(), **features)
    for term in sites.cost_terms(10, 0.5):
        assert term.team_scale == pytest.approx(1.0 / 3600.0 if term.name == "site_missing" else 1.0), term.name
        assert term.own_scale.shape == (0,)
    for field in sites.fields(10, 0.5):
        assert np.isfinite([field.lowest, field.highest]).all()
        assert np.shape(field.share_of) == (0,)
    zero = np.zeros((1, 0))
    state = sites.initial(sites.parameters, zero)
    assert all(np.shape(figures)[:2] == (1, 0) for figures in (state.backlog_kws, state.f_mhz))


def test_features_act_from_the_work_to_the_grid():
    sites = group(2, **FEATURES)
    names = ["RoutedSites", "BatchedSites", "SmoothedSite", "CooledSite", "UpsSite", "ServedSites"]
    assert [type(feature).__name__ for feature in sites.features] == names
    assert sites.features[-1].moves_late
    at_once = group(2, routing={"move_latency_s": 0.0}, service={})
    assert not at_once.features[-1].moves_late
    assert not group(2, service={}).features[-1].moves_late
    channels = ["clock", "q", "route", "batch", "floor", "ramp_up", "ramp_down", "return"]
    assert [channel.name for channel in sites.channels] == channels


def test_largest_queue_and_cost_of_boosted_sites_that_exchange_work():
    """0.2 idle, 1.3 at most, 20 steps of 0.5 s: up to 1.1 of the rating arrives, and 0.8 more from other sites."""
    given: Any = {"boost_share": 1.3, "idle_share": 0.2}
    for routing, most, longest_s in ((None, 1.1, 13.0), ({}, 1.9, 23.0)):
        sites = group(2, **given, routing=routing)
        backlog, clock, leftover, *_ = sites.cost_terms(20, 0.5)
        assert (backlog.largest, leftover.largest) == (pytest.approx(10.0 * most), pytest.approx(10.0 * most))
        assert (backlog.team_scale, backlog.at_end, leftover.at_end) == (200.0, False, True)
        assert (clock.team_scale, clock.largest) == (2.0, 1.0)
        assert sites.fields(20, 0.5)[1].highest == pytest.approx(longest_s)
    routed = group(2, **given, routing={"move_latency_s": 0.2})
    assert routed.fields(20, 0.5)[3].highest == pytest.approx(1.1 / 0.8)
    assert routed.cost_terms(20, 0.5)[3].largest == pytest.approx(0.26)
    served = group(2, **given, service={})
    assert served.cost_terms(20, 0.5)[3].largest == pytest.approx(23.0)
    batched = group(2, **given, batching={"gather_s": 0.2})
    # Batches of 512 instead of 64 wait 1.4 s longer, and take 0.7 + 0.3 / 8 of the energy.
    assert batched.cost_terms(20, 0.5)[3].largest == pytest.approx(1.1 * 1.4 / 0.7375)
