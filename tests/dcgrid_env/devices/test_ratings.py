"""Ratings and phases of the slots of a group, one for all or one for each."""

from types import SimpleNamespace

import numpy as np
import pytest

from dcgrid_env import Cooling, DataCenters, Inverters
from dcgrid_env.core.checked import FieldError
from dcgrid_env.devices.phases import PHASES, check_phases, phases_of
from dcgrid_env.devices.ratings import check_each, check_rating, per_device, read_only


class Owner(SimpleNamespace):
    """An owner of the field that is checked."""


@pytest.mark.parametrize("value", [1e-6, 1e9, (5.0, 1e9)])
def test_ratings_within_the_range(value):
    check_rating(Owner(x=value), "x", 2)


@pytest.mark.parametrize("value", [0.0, -1.0, 1.001e9, (1.0,), (1.0, 0.0), (1.0, 2.0, 3.0), "1", True])
def test_ratings_that_cannot_be(value):
    with pytest.raises(
        FieldError, match=r"Owner: x is .*; give one positive number of at most 1e\+09, or one for each"
    ):
        check_rating(Owner(x=value), "x", 2)


def test_figures_of_each_device_include_the_ends_of_the_range():
    for value in (1.0, 3.0, (1.0, 3.0)):
        check_each(Owner(x=value), "x", 2, 1.0, 3.0)
    for value in (0.999, 3.001, (1.0, 3.001), (1.0,)):
        with pytest.raises(
            FieldError, match=r"Owner: x is .*; give one finite number in \[1, 3\], or one for each of the 2"
        ):
            check_each(Owner(x=value), "x", 2, 1.0, 3.0)


def test_arrays_over_the_devices_are_floats_and_may_be_closed():
    np.testing.assert_array_equal(per_device(3, 2), [3.0, 3.0])
    assert per_device((3, 4), 2).dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        read_only(per_device(3.0, 2))[0] = 1.0


def test_ratings_of_sites_worked_by_hand():
    sites = DataCenters(
        count=2, p_rated_kw=(100.0, 300.0), s_rated_share=1.5, q_max_share=0.5, idle_share=0.2, f_min_mhz=200.0,
        cooling=Cooling(cooling_share=0.4, auxiliary_share=0.1), boost_share=1.2,
    )  # fmt: skip
    p = sites.parameters
    np.testing.assert_allclose(
        p, [[100, 300], [20, 60], [80, 240], [200, 200], [1410, 1410], [225, 675], [50, 150]], rtol=1e-12
    )
    np.testing.assert_allclose(sites.q_limit_kvar, [50.0, 150.0])
    np.testing.assert_array_equal(sites.converter_kva, p.s_rated_kva)
    np.testing.assert_array_equal(sites.p_scale_kw, [100.0, 300.0])
    assert sites.largest_draw_share == pytest.approx(1.2 * 1.4 + 0.1)
    assert sites.largest_export_share == 0.0
    clock, q = sites.channels
    for channel, lowest, highest, rest in ((clock, 200.0, 1410.0, 1410.0), (q, [-50, -150], [50, 150], 0.0)):
        for found, expected in zip(
            (channel.lowest, channel.highest, channel.rest), (lowest, highest, rest), strict=True
        ):
            np.testing.assert_array_equal(found, np.broadcast_to(expected, 2))
    assert sites.work_classes == 1


def test_the_clock_moves_by_a_share_of_its_range():
    sites = DataCenters(count=1, p_rated_kw=10.0, s_rated_share=1.5, q_max_share=0.5, f_min_mhz=400.0, f_max_mhz=900.0)
    state = SimpleNamespace(f_mhz=np.array([[500.0]]), f_last_mhz=np.array([[750.0]]), features=())
    assert sites.amount("clock_movement", sites.parameters, state) == pytest.approx(0.5)
    still = DataCenters(count=1, p_rated_kw=10.0, s_rated_share=1.5, q_max_share=0.5, f_min_mhz=900.0, f_max_mhz=900.0)
    assert still.amount("clock_movement", still.parameters, state) == pytest.approx(250.0)


@pytest.mark.parametrize("value", [None, *PHASES, ("a", "abc")])
def test_phases_that_may_be(value):
    owner = Owner(phases=value, count=2)
    check_phases(owner, 2)
    assert phases_of(owner) == (value if isinstance(value, tuple) else (value, value))


@pytest.mark.parametrize("value", ["d", "ba", ("a",), ("a", "d"), ("a", "b", "c")])
def test_phases_that_cannot_be(value):
    with pytest.raises(
        FieldError, match=r"Owner: phases is .*; give one of a, b, c, ab, bc, ac, abc, or one for each of"
    ):
        check_phases(Owner(phases=value), 2)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"injection": (0.5, 1.1)}, "Inverters: injection has 2 shares, 1.1 among them; give numbers from -1 to 1"),
        ({"injection": (-1.01,)}, "has 1 shares, -1.01 among them"),
        ({"injection": (True,)}, "True among them"),
        ({"injection": 5}, "Inverters: injection is 5; give 'pv', a PowerTrace"),
        ({"buses": "7"}, "Inverters: buses is .*; give a tuple of buses"),
        ({"s_rated_kva": 0.0}, "Inverters: s_rated_kva is 0.0; give one positive number"),
        ({"ride_through": 5}, "Inverters: ride_through is 5; give RideThrough"),
        ({"ride_through": {"curve": ["itic", "itic"]}}, "curve has 2 curves; give one, or one for each of 1"),
    ],
)
def test_inverters_that_cannot_be_are_refused_by_field(fields, message):
    with pytest.raises(FieldError, match=message):
        Inverters(**{"buses": ("7",), "s_rated_kva": 50.0} | fields)


def test_figures_of_inverters():
    inverters = Inverters(buses=("7", "9"), s_rated_kva=(50.0, 80.0), injection=(-1.0, 1.0))
    assert inverters.count == 2
    assert inverters.largest_draw_share == 1.0
    for figures in (inverters.converter_kva, inverters.p_scale_kw, inverters.q_limit_kvar, inverters.parameters[0]):
        np.testing.assert_array_equal(figures, [50.0, 80.0])
    (q,) = inverters.channels
    np.testing.assert_array_equal([q.lowest, q.highest, q.rest], [[-50, -80], [50, 80], [0, 0]])
    assert inverters.fields(5, 1.0) == inverters.cost_terms(5, 1.0) == ()
    zero = np.zeros((1, 2))
    state, draw = inverters.step(
        inverters.parameters, inverters.initial(inverters.parameters, zero), (zero,), zero + 3, 1
    )
    assert state == ()
    np.testing.assert_array_equal(draw, [[-3.0, -3.0]])
