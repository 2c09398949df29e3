"""Inverters that can trip: their cost term and fields."""

import pytest

from dcgrid_env import Inverters, RideThrough


@pytest.mark.parametrize(("slots", "team_scale"), [(0, 1.0), (1, 1.0), (2, 2.0)])
def test_trips_of_inverters_are_a_mean_over_them(slots, team_scale):
    rule = RideThrough(curve="itic", trip_weight=3.0, return_delay_s=40.0)
    inverters = Inverters(buses=tuple(range(1, slots + 1)), s_rated_kva=50.0, ride_through=rule)
    (trips,) = inverters.cost_terms(10, 1.0)
    assert (trips.team_scale, trips.largest, trips.weight) == (team_scale, 1.0, 3.0)
    assert (trips.at_end, trips.is_constraint) == (False, True)
    assert [field.share_of.tolist() for field in inverters.fields(10, 1.0)] == [[1.0] * slots] * 2 + [[40.0] * slots]
