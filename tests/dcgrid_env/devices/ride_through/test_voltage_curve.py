"""Ride-through curves: published figures, and what is refused."""

from itertools import pairwise

import numpy as np
import pytest

from dcgrid_env.core.checked import FieldError
from dcgrid_env.devices.ride_through.voltage_curve import CURVES, Elements, RideThroughCurve, curves_of, plain_curve

FOR_GOOD = float("inf")


def rides_through_s(curve, v_pu):
    """The time for which a voltage is ridden through, s, as the timers of devices see it."""
    elements = Elements((curve, RideThroughCurve(under=((0.5, 1.0),))))
    return np.where(elements.sign * v_pu < elements.threshold, elements.time_s, np.inf).min(-1)[0]


@pytest.mark.parametrize(
    ("name", "v_pu", "time_s"),
    [
        ("itic", 0.0, 0.02),
        ("itic", 0.69, 0.02),
        ("itic", 0.70, 0.5),
        ("itic", 0.80, 10.0),
        ("itic", 0.90, FOR_GOOD),
        ("itic", 1.10, FOR_GOOD),
        ("itic", 1.20, 0.5),
        ("itic", 1.30, 0.003),
        ("ercot-2026", 0.80, 2.0),
        ("ercot-2026", 0.79, 0.5),
        ("ercot-2026", 0.20, 0.25),
        ("ercot-2026", 0.0, 0.15),
        ("ercot-2026", 1.15, 2.0),
        ("ieee1547-cat2", 0.88, FOR_GOOD),
        ("ieee1547-cat2", 1.21, 0.16),
        ("caiso-proposal", 0.89, 6.0),
        ("caiso-proposal", 0.69, 3.0),
        ("caiso-proposal", 0.49, 1.2),
        ("caiso-proposal", 0.24, 0.15),
    ],
)
def test_a_named_curve_has_the_published_figures(name, v_pu, time_s):
    assert rides_through_s(CURVES[name], v_pu) == time_s


@pytest.mark.parametrize("name", CURVES)
def test_no_voltage_is_ridden_through_longer_than_one_nearer_to_nominal(name):
    times = [rides_through_s(CURVES[name], v) for v in np.linspace(0.0, 2.0, 401)]
    assert all(a <= b for a, b in pairwise(times[:201]))
    assert all(a >= b for a, b in pairwise(times[200:]))


def test_the_plain_form_is_the_name_or_the_tables():
    assert plain_curve(CURVES["itic"]) == "itic"
    own = RideThroughCurve(under=((0.9, 1.0),), over=((1.2, 0.5),))
    assert curves_of(plain_curve(own)) == own
    assert curves_of(["itic", "itic"]) == (CURVES["itic"], CURVES["itic"])


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ({"under": ((0.9, 1.0), (0.8, 2.0))}, r"under is .*2.0 s follows 1.0 s; what is farther from 1 p.u. cannot"),
        ({"under": ((0.8, 1.0), (0.9, 0.5))}, r"0.9 follows 0.8; give voltages falling from below 1 p.u."),
        ({"over": ((1.2, 1.0), (1.1, 0.5))}, r"over is .*1.1 follows 1.2; give voltages rising from above 1 p.u."),
        ({"under": ((0.9, -1.0),)}, r"the time -1.0 cannot be; give seconds of at least 0"),
        ({"under": ((0.9, float("inf")),)}, r"the time inf cannot be"),
        ({"under": ((1.1, 1.0),)}, r"the voltage 1.1 cannot be; give them falling"),
        ({"over": ((float("nan"), 1.0),)}, r"the voltage nan cannot be"),
        ({"under": (0.9, 1.0)}, r"under is \(0.9, 1.0\); give pairs of a voltage in p.u. and seconds"),
        ({}, r"under is \(\); give a threshold here or in over"),
    ],
)
def test_a_curve_that_cannot_be_is_refused_by_field_value_and_remedy(tables, said):
    with pytest.raises(FieldError, match=f"RideThroughCurve: .*{said}"):
        RideThroughCurve(**tables)


def test_an_unknown_name_lists_those_there_are():
    with pytest.raises(FieldError, match=r"curve is 'cbema'; choose one of itic, ercot-2026"):
        curves_of("cbema")


def test_the_tables_of_the_named_curves():
    assert {name: (curve.under, curve.over) for name, curve in CURVES.items()} == {
        "itic": (((0.9, 10.0), (0.8, 0.5), (0.7, 0.02)), ((1.1, 0.5), (1.2, 0.003), (1.4, 0.001))),
        "ercot-2026": (((0.9, 2.0), (0.8, 0.5), (0.5, 0.25), (0.2, 0.15)), ((1.1, 2.0), (1.2, 0.0))),
        "ieee1547-cat2": (((0.88, 10.0), (0.45, 0.16)), ((1.1, 2.0), (1.2, 0.16))),
        "caiso-proposal": (((0.9, 6.0), (0.7, 3.0), (0.5, 1.2), (0.25, 0.15)), ((1.1, 2.0), (1.2, 0.0))),
    }


@pytest.mark.parametrize(
    "tables", [{"under": ((0.9, 1.0), (0.8, 1.0))}, {"over": ((10.0, 0.0),)}, {"under": ((0.0, 0.0),)}]
)
def test_equal_times_and_the_ends_of_the_ranges_are_allowed(tables):
    curve = RideThroughCurve(**tables)
    assert {"under": curve.under, "over": curve.over} == {"under": (), "over": ()} | tables


@pytest.mark.parametrize(
    "tables",
    [{"under": ((1.0, 1.0),)}, {"over": ((1.0, 1.0),)}, {"under": ((0.9, 1.0), (0.9, 0.5))}, {"over": ((10.1, 1.0),)},
     {"over": ((1.2, 1.0), (1.2, 1.0))}, {"under": [(0.9, 1.0, 2.0)]}, {"under": 0.9}],
)  # fmt: skip
def test_edges_of_a_curve_that_cannot_be(tables):
    with pytest.raises(FieldError, match="RideThroughCurve: "):
        RideThroughCurve(**tables)


def test_a_mapping_with_another_field_is_refused():
    with pytest.raises(FieldError, match="'above' is no field; give under, over"):
        curves_of({"under": [[0.9, 1.0]], "above": []})


def test_shorter_curves_never_pick_up_in_their_missing_elements():
    elements = Elements((RideThroughCurve(under=((0.9, 1.0), (0.5, 0.1))), RideThroughCurve(over=((1.2, 2.0),))))
    np.testing.assert_array_equal(elements.sign, [1.0, 1.0, -1.0])
    np.testing.assert_array_equal(elements.threshold, [[0.9, 0.5, -np.inf], [-np.inf, -np.inf, -1.2]])
    np.testing.assert_array_equal(elements.time_s, [[1.0, 0.1, np.inf], [np.inf, np.inf, 2.0]])
    assert (elements.count, elements.n_under) == (3, 2)
