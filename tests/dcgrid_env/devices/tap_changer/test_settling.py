"""Settled taps: OpenDSS's static control to the tap, one tap a round, rows by themselves, cycles."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import load_feeder
from dcgrid_env.devices.tap_changer import settling
from dcgrid_env.devices.tap_changer.relay import direction, relay_settings, relay_volts
from dcgrid_env.devices.tap_changer.settling import settled_taps
from dcgrid_env.powerflow import Control, solve_unbalanced
from helpers.feeders import THREE_PHASE
from helpers.opendss_points import published_point, rows
from helpers.places import SHARED_THREE_PHASE, require


def nominal(feeder, n_row=1, multiplier=1.0) -> Any:
    return tuple(np.tile(multiplier * load, (n_row, 1)) for load in (feeder.p_load_kw, feeder.q_load_kvar))


def opendss_move(feeder):
    """What OpenDSS's static control does in a round: max(1, trunc(0.7 round(boost / step))) taps."""
    most = np.array(feeder.network.regulator.max_taps_per_move, float)

    def move(settings, missing_v):
        wanted = np.round(np.abs(missing_v) / np.diag(settings.volts_per_tap))
        return np.minimum(np.maximum(np.trunc(0.7 * wanted + 1e-9), 1.0), most)

    return move


def relays_at(feeder, tap, multiplier=1.0):
    control = Control(feeder.tap_ratio(tap))
    return relay_volts(
        relay_settings(feeder), solve_unbalanced(feeder, *nominal(feeder, len(tap), multiplier), control=control)
    )


@pytest.mark.parametrize("name", THREE_PHASE)
def test_opendss_static_control_to_the_tap(name):
    """From the neutral taps, where OpenDSS began; the voltages of the regulated point are those of these taps."""
    folder, feeder = require(SHARED_THREE_PHASE) / name, load_feeder(name)
    published = {row["name"]: float(row["tap_regulated"]) for row in rows(folder / "regulators.csv")}
    wanted = [published[one] for one in feeder.network.regulator.name]
    neutral = np.array([feeder.network.regulator.tap_neutral], float)
    found = settled_taps(feeder, *nominal(feeder), tap=neutral, move=opendss_move(feeder))
    assert found.tap[0].tolist() == wanted
    assert found.settled.all()
    at = published_point(name, "regulated")
    solution = solve_unbalanced(feeder, at.p_kw, at.q_kvar, control=Control(feeder.tap_ratio(found.tap[0])))
    np.testing.assert_allclose(solution.v_pu, at.v_pu, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("name", THREE_PHASE)
@pytest.mark.parametrize("multiplier", [0.5, 1.0, 1.1])
def test_all_come_to_rest_in_band_or_at_an_end(name, multiplier):
    feeder = load_feeder(name)
    found = settled_taps(feeder, *nominal(feeder, 1, multiplier))
    assert found.settled.all()
    assert (direction(relay_settings(feeder), relays_at(feeder, found.tap, multiplier), found.tap) == 0.0).all()


def test_each_row_settles_by_itself():
    feeder = load_feeder("ieee34-3ph")
    multipliers = np.array([0.4, 1.0, 0.7, 1.15])[:, None]
    p, q = multipliers * feeder.p_load_kw, multipliers * feeder.q_load_kvar
    together = settled_taps(feeder, p, q)
    assert len({tuple(tap) for tap in together.tap.tolist()}) == 4
    for row in range(4):
        alone = settled_taps(feeder, p[row : row + 1], q[row : row + 1])
        np.testing.assert_array_equal(alone.tap[0], together.tap[row])


def test_who_is_not_controlled_stays_at_the_beginning():
    feeder = load_feeder("ieee13-3ph")
    found = settled_taps(feeder, *nominal(feeder), tap=np.zeros((1, 3)), controlled=np.array([1.0, 0.0, 1.0]))
    assert found.tap[0, 1] == 0.0
    assert (found.tap[0, [0, 2]] > 5.0).all()


def test_a_row_that_goes_in_a_circle_is_stopped():
    """Eight taps at once go beyond the band and back for ever."""
    feeder = load_feeder("ieee13-3ph")

    def far_too_many(settings, missing_v):
        return 8.0 + 0.0 * missing_v

    found = settled_taps(feeder, *nominal(feeder), move=far_too_many, tap=np.zeros((1, 3)))
    assert not found.settled.any()
    assert found.rounds < 10


def test_loads_without_a_solution_leave_the_taps(monkeypatch):
    feeder = load_feeder("ieee13-3ph")
    p, q = nominal(feeder, 2)
    p[1, -1] += 1e6  # a device, whose power does not fall with the voltage
    found = settled_taps(feeder, p, q)
    assert found.settled.tolist() == [True, False]
    assert found.tap[1].tolist() == feeder.base_tap.tolist()
    monkeypatch.setattr(settling, "MOST_ROUNDS", 3)
    assert settled_taps(feeder, *nominal(feeder), tap=np.zeros((1, 3))).settled.tolist() == [False]
