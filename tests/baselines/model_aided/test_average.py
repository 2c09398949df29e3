"""The average over noisy measurements: its weight against the Kalman filter step by step, and on a random walk."""

from typing import Any, cast

import numpy as np
import pytest

from dcgrid_env import forecast, make_scenario
from dcgrid_env.baselines.model_aided.average import Average, newest_weight
from dcgrid_env.baselines.model_aided.commissioning import commission, site_of


class Known:
    """The one field that the average reads."""

    def __init__(self, newest: float) -> None:
        self.newest = np.array([[newest]])


def test_the_weight_is_where_the_filter_settles():
    change, noise = np.random.default_rng(0).normal(0.0, [1e-3, 4e-3], (500, 2)), 2e-3
    variance = (change**2).mean(axis=0)
    error, gain = np.full(2, 1.0), np.zeros(2)
    for _ in range(200):
        gain = (error + variance) / (error + variance + noise**2)
        error = (1.0 - gain) * (error + variance)
    assert newest_weight(noise, change) == pytest.approx(gain)
    assert error == pytest.approx(gain * noise**2)
    assert newest_weight(1e-9, change) == pytest.approx([1.0, 1.0])
    assert newest_weight(noise, 0.0 * change) == pytest.approx([0.1, 0.1])


def test_the_first_measurements_count_alike():
    average, known = Average(), cast(Any, Known(0.2))
    seen = [average(known, np.array([[e]])).item() for e in (1.0, 3.0, 8.0)]
    assert seen == pytest.approx([1.0, 2.0, 4.0])
    for _ in range(2):
        average(known, np.array([[4.0]]))
    assert average(known, np.array([[9.0]])).item() == pytest.approx(5.0)


def test_its_error_on_a_random_walk_is_that_of_the_regression():
    rng, noise = np.random.default_rng(1), 5e-3
    change = rng.normal(0.0, 2e-3, (20_000, 1))
    weight = float(newest_weight(noise, change)[0])
    true = change.cumsum()
    average, known = Average(), cast(Any, Known(weight))
    error = [average(known, np.array([[e + rng.normal(0.0, noise)]])).item() - e for e in true]
    assert np.mean(np.square(error)) == pytest.approx(weight * noise**2, rel=0.05)


@pytest.mark.parametrize(("preset", "averages"), [("ieee33", False), ("robust", True)])
def test_without_noise_the_newest_measurement_is_all(preset, averages):
    scenario = make_scenario(preset)
    newest = commission(site_of(scenario), forecast(scenario, 0).buses[None]).newest
    assert (newest > 0.0).all()
    assert (newest < 1.0).all() if averages else (newest == 1.0).all()
