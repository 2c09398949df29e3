"""The law of two work classes: its figures against those that its parameters come from, and steps worked by hand."""

import numpy as np
import pytest

from dcgrid_env import LinearDvfs, PrefillDecodeDvfs
from dcgrid_env.devices import DataCenterParams, work_classes_of

SITE = DataCenterParams(*(np.array([v]) for v in (1000.0, 200.0, 800.0, 210.0, 1400.0, 1100.0, 330.0)))
PLENTY = 1e9


def busy(law: PrefillDecodeDvfs, f_mhz: float, compute: float, memory: float) -> tuple[float, float]:
    """Share of the work at the top clock that is done, and of the power, with more work than can be."""
    served, power = law.serve(SITE, np.array([f_mhz]), PLENTY * np.array([[compute, memory]]))
    return float(served.sum()) / 800.0, float(power[0]) / 800.0


def test_compute_follows_the_clock():
    # Of 1400 MHz, 100 are 7.1 % of the throughput.
    assert busy(PrefillDecodeDvfs(), 1300.0, 1.0, 0.0)[0] == pytest.approx(1300.0 / 1400.0)
    assert busy(PrefillDecodeDvfs(), 210.0, 1.0, 0.0)[0] == pytest.approx(0.15)


def test_decode_hardly_follows_it():
    assert 1.0 / busy(PrefillDecodeDvfs(), 1120.0, 0.0, 1.0)[0] == pytest.approx(1.005)
    assert 1.0 / busy(PrefillDecodeDvfs(), 350.0, 0.0, 1.0)[0] == pytest.approx(1.06)
    assert 1.0 / busy(PrefillDecodeDvfs(), 210.0, 0.0, 1.0)[0] == pytest.approx(1.0 + 0.02 / 0.15 - 0.02)


def test_a_token_takes_up_to_42_percent_less_energy():
    # At an idle draw of 0.2 and a dynamic one of 0.45 of the rating, by the clock from 210 to 1410 MHz.
    clocks = np.linspace(210.0, 1410.0, 241) / 1410.0 * 1400.0
    energy = []
    for f in clocks:
        speed, power = busy(PrefillDecodeDvfs(), f, 0.0, 1.0)
        energy.append((0.2 + 0.45 * power) / speed)
    saved = 1.0 - np.array(energy) / 0.65
    assert saved.max() == pytest.approx(0.42, abs=0.002)
    assert clocks[saved.argmax()] / 1400.0 == pytest.approx(0.3, abs=0.005)


def test_power_is_convex_in_the_clock_and_falls_faster_than_compute():
    clocks = np.linspace(210.0, 1400.0, 60)
    for work_class in ((1.0, 0.0), (0.0, 1.0), (0.3, 0.7)):
        power = np.array([busy(PrefillDecodeDvfs(), f, *work_class)[1] for f in clocks])
        assert np.all(np.diff(power) > 0)
        if work_class != (0.3, 0.7):  # the classes' shares of time move with the clock
            assert np.all(np.diff(power, 2) > 0)
    at_half = busy(PrefillDecodeDvfs(), 700.0, 1.0, 0.0)
    assert at_half == pytest.approx((0.5, 0.4 / 2 + 0.6 / 8))


def test_work_classes_share_the_time_in_proportion_to_the_work():
    # Half the clock: compute at 1/2, decode at 1/1.02. 400 and 600 kW take 2 x 0.5 + 1.02 x 0.75 = 1.765 intervals.
    law = PrefillDecodeDvfs()
    served, power = law.serve(SITE, np.array([700.0]), np.array([[400.0, 600.0]]))
    np.testing.assert_allclose(served, [[400.0 / 1.765, 600.0 / 1.765]])
    mu = 0.34 + 0.66 / 8
    np.testing.assert_allclose(power, [(400.0 * 2 * 0.275 + 600.0 * 1.02 * mu) / 1.765])
    # A tenth of it all fits, and takes a tenth of the energy.
    served, less = law.serve(SITE, np.array([700.0]), np.array([[40.0, 60.0]]))
    np.testing.assert_array_equal(served, [[40.0, 60.0]])
    np.testing.assert_allclose(less, 0.1 * 1.765 * power)


def test_top_clock_draws_what_it_serves_whatever_the_composition():
    rng = np.random.default_rng(0)
    work = rng.uniform(0.0, 1.0, (500, 1, 2)) * 800.0
    served, power = PrefillDecodeDvfs().serve(SITE, np.full((500, 1), 1400.0), work)
    fits = work.sum(-1) <= 800.0
    assert 100 < fits.sum() < 400
    np.testing.assert_array_equal(served[fits], work[fits])
    np.testing.assert_array_equal(power[fits], work.sum(-1)[fits])
    np.testing.assert_allclose(power[~fits], 800.0)
    np.testing.assert_allclose(served.sum(-1), power)


def test_no_work_draws_nothing():
    served, power = PrefillDecodeDvfs().serve(SITE, np.array([210.0]), np.zeros((1, 2)))
    assert served.tolist() == [[0.0, 0.0]]
    assert power.tolist() == [0.0]


def test_the_linear_law_is_that_of_compute_without_a_cube():
    f, work = np.array([[210.0], [700.0], [1400.0]]), np.array([[300.0], [900.0], [900.0]])
    linear = LinearDvfs().serve(SITE, f, work)
    two_classes = PrefillDecodeDvfs(compute_linear_share=1.0).serve(SITE, f, np.stack((work, 0.0 * work), axis=-1))
    np.testing.assert_allclose(two_classes[0].sum(-1), linear[0])
    np.testing.assert_allclose(two_classes[1], linear[1])


@pytest.mark.parametrize("field", ["decode_clock_share", "decode_memory_share", "compute_linear_share"])
@pytest.mark.parametrize("value", [-0.1, 1.1, float("nan"), "0.5", None])
def test_a_parameter_that_is_no_share_is_refused(field, value):
    with pytest.raises(ValueError, match=rf"PrefillDecodeDvfs: {field} is {value!r}; give a share from 0 to 1"):
        PrefillDecodeDvfs(**{field: value})


@pytest.mark.parametrize("value", [0.0, 1.0, 0, 1])
def test_a_share_may_be_all_or_nothing(value):
    assert PrefillDecodeDvfs(value, value, value).compute_linear_share == value


def test_work_classes_of_a_law():
    assert (work_classes_of(LinearDvfs()), work_classes_of(PrefillDecodeDvfs()), work_classes_of(object())) == (1, 2, 1)
