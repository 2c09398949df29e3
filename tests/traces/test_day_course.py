"""Daily profiles against their sources."""

import numpy as np
import pytest

from dcgrid_env.traces import load_share, sun_share


def test_load_has_the_tables_values_in_the_middle_of_the_hours():
    wanted = [0.64, 0.60, 0.56, 0.87, 1.0, 0.92, 0.72]
    np.testing.assert_allclose(load_share(np.array([0.5, 1.5, 4.5, 8.5, 11.5, 20.5, 23.5])), wanted, atol=1e-6)


def test_load_is_linear_between_them_and_the_same_every_day():
    assert load_share(8.0) == pytest.approx((0.76 + 0.87) / 2, abs=1e-6)
    assert load_share(0.0) == pytest.approx((0.72 + 0.64) / 2, abs=1e-6)
    hours = np.linspace(0.0, 24.0, 97)
    np.testing.assert_allclose(load_share(hours + 48.0), load_share(hours), atol=1e-6)
    assert load_share(hours).min() == pytest.approx(0.56, abs=1e-6)
    assert load_share(hours).max() == 1.0


def test_sun_is_down_at_night_highest_at_noon_and_alike_before_and_after():
    hours = np.linspace(0.0, 24.0, 241)
    share = sun_share(hours)
    assert share[120] == 1.0 == share.max()
    assert (share[(hours < 4.5) | (hours > 19.5)] == 0.0).all()
    np.testing.assert_allclose(share, share[::-1], atol=2e-6)
    assert (np.diff(share[hours <= 12.0]) >= 0.0).all()
    np.testing.assert_array_equal(sun_share(hours + 24.0), share)


def test_sun_by_hand_at_eight():
    # sin 40 sin 23.45 = 0.25579, cos 40 cos 23.45 = 0.70276: cos z is 0.60717 at 8 h and 0.95855 at noon.
    wanted = 0.60717 * np.exp(-0.057 / 0.60717) / (0.95855 * np.exp(-0.057 / 0.95855))
    assert sun_share(8.0) == pytest.approx(wanted, abs=1e-4)
