"""Regulators with other ends than those of the bundled feeders: set points, agents of taps, and what is reported."""

from dataclasses import replace

import numpy as np
import pytest

from dcgrid_env import ThreePhaseFeeder, load_feeder
from dcgrid_env.devices.tap_changer.regulator_control import RegulatorControl
from dcgrid_env.devices.tap_changer.regulator_set_points import RegulatorSetPoints
from dcgrid_env.devices.tap_changer.regulator_state import initial_regulators
from dcgrid_env.devices.tap_changer.regulator_view import regulator_view
from dcgrid_env.devices.tap_changer.relay import RelayBand, relay_settings
from dcgrid_env.devices.tap_changer.settling import settled_taps
from dcgrid_env.devices.tap_changer.tap_changers import TapChangers


def feeder_of(**columns):
    """ieee13-3ph with other columns in the table of its three regulators, which begin at the taps 10, 8 and 11."""
    network = load_feeder("ieee13-3ph").network
    return ThreePhaseFeeder.from_network(replace(network, regulator=replace(network.regulator, **columns)))


UNEVEN = feeder_of(
    tap_min=(-4, -20, -2), tap_max=(12, 16, 14), vreg_v=(120.0, 121.0, 125.0), band_v=(2.0, 3.0, 1.0),
    tap_delay_s=(0.0, 2.0, 5.0), delay_s=(10.0, 20.0, 40.0),
)  # fmt: skip


def test_set_points_of_a_bank_are_those_of_all_its_regulators():
    control = RegulatorControl(offset_v=(("reg1", 1.5),), hold_s=90.0)
    bank = RegulatorSetPoints.of_feeder(UNEVEN, (0, 1, 2), control)
    assert bank.members == ((0, 1, 2),)
    assert (bank.farthest, bank.target_v, bank.rest_offset_v) == ((20.0,), (122.0,), (1.5,))
    assert (bank.rest_half_band_v, bank.narrowest_v, bank.hold_s) == ((1.5,), (0.375,), 90.0)
    found = [(f.name, f.lowest, f.highest, f.share_of.tolist(), f.of_band) for f in bank.fields(10, 1.0)]
    assert found == [
        ("mean_tap", -1.0, 1.0, [20.0], False),
        ("offset", -1.0, 1.0, [4.0], False),
        ("half_band", 0.0, 1.0, [3.0], False),
        ("since_change", 0.0, 1.0, [90.0], False),
        ("mean_relay", -1.0, 1.0, [122.0], True),
    ]
    first = RegulatorSetPoints.of_feeder(UNEVEN, (0,), control)
    assert (first.farthest, first.target_v, first.rest_half_band_v) == ((12.0,), (120.0,), (1.0,))
    fixed = feeder_of(tap=(0, 0, 0), max_taps_per_move=(0, 0, 0))
    assert RegulatorSetPoints.of_feeder(fixed, (0, 1, 2), control).farthest == (1.0,)


@pytest.mark.parametrize(
    ("offset_v", "ranges"), [(5.0, (-4.0, 5.0, 5.0)), (-6.0, (-6.0, 4.0, 6.0)), (0.0, (-4.0, 4.0, 4.0))]
)
def test_the_range_of_an_offset_extends_to_its_default(offset_v, ranges):
    bank = RegulatorSetPoints.of_feeder(UNEVEN, (0, 1, 2), RegulatorControl(offset_v=offset_v))
    channel = bank.channels[0]
    assert (channel.lowest.item(), channel.highest.item(), bank.fields(1, 1.0)[1].share_of.item()) == ranges
    assert channel.rest.item() == offset_v


def test_a_wide_band_extends_the_range_of_half_bands():
    wide = RegulatorSetPoints.of_feeder(feeder_of(band_v=(8.0, 2.0, 2.0)), (0, 1, 2), RegulatorControl())
    half = wide.channels[1]
    assert (half.lowest.item(), half.highest.item(), half.rest.item()) == (0.375, 4.0, 4.0)


def test_observations_of_set_points():
    bank = RegulatorSetPoints.of_feeder(UNEVEN, (0, 1, 2), RegulatorControl())
    state = bank.initial(bank.parameters, np.zeros((1, 1)))._replace(setpoint_age_s=np.array([[70.0]]))
    state = state._replace(mean_tap=np.array([[7.0]]), deviation_v=np.array([[-2.0]]), offset_v=np.array([[0.5]]))
    assert [figure.item() for figure in bank.observe(bank.parameters, state, None)] == [7.0, 0.5, 1.5, 60.0, -2.0]
    after, _ = bank.step(bank.parameters, state, (np.array([[2.0]]), np.array([[1.0]])), None, 1.0)
    assert (after.offset_v.item(), after.half_band_v.item(), after.setpoint_age_s.item()) == (2.0, 1.0, 1.0)


def test_agents_of_taps_worked_by_hand():
    taps = TapChangers.of_feeder(UNEVEN, (0, 2))
    tap, since, relay = taps.fields(50, 2.0)
    assert (tap.lowest, tap.highest, tap.share_of.tolist()) == (-1.0, 1.0, [12.0, 14.0])
    assert (since.lowest, since.highest, since.share_of.tolist()) == (0.0, 1.0, [100.0, 100.0])
    assert (relay.lowest, relay.highest, relay.share_of.tolist(), relay.of_band) == (-1.0, 1.0, [120.0, 125.0], True)
    (channel,) = taps.channels
    assert [channel.lowest.tolist(), channel.highest.tolist()] == [[-4.0, -2.0], [12.0, 14.0]]
    assert taps.parameters.tap_delay_s.tolist() == [1e-3, 5.0]
    state = taps.initial(taps.parameters, np.zeros((1, 2)))
    assert [field.tolist() for field in state] == [[[10.0, 11.0]], [[1e-3, 5.0]], [[0.0, 0.0]], [[120.0, 125.0]]]
    state, _ = taps.step(taps.parameters, state, (np.array([[9.0, 14.0]]),), None, 7.0)
    assert [state.tap.tolist(), state.moved.tolist()] == [[[9.0, 13.0]], [[1.0, 2.0]]]
    # The drive of the second was ready, and needs 5 s for a tap: 12 s make two, and leave 2 s.
    assert state.since_s[0, 1] == pytest.approx(2.0)
    state, _ = taps.step(taps.parameters, state, (np.array([[9.0, 13.0]]),), None, 7.0)
    assert state.moved.tolist() == [[0.0, 0.0]]
    assert state.since_s[0, 1] == pytest.approx(9.0)
    observed = taps.observe(taps.parameters, state._replace(relay_v=np.array([[119.0, 127.5]])), None)
    assert [observed[0].tolist(), observed[2].tolist()] == [[[9.0, 13.0]], [[-1.0, 2.5]]]
    assert TapChangers.of_feeder(feeder_of(tap=(0,) * 3, tap_min=(0,) * 3, tap_max=(0,) * 3), (0,)).fields(1, 1.0)[
        0
    ].share_of.tolist() == [1.0]


def test_what_is_reported_of_regulators_worked_by_hand():
    settings = relay_settings(UNEVEN)
    state = initial_regulators(np.array([[6.0, -5.0, 7.0]]), np.array([[121.0, 119.5, 125.0]]))
    for figures in state[2:]:
        np.testing.assert_array_equal(figures, [[0.0, 0.0, 0.0]])
    state = state._replace(out_of_band_s=np.array([[5.0, 1.0, 5.0]]), in_sequence=np.array([[0.0, 1.0, 1.0]]))
    band = RelayBand(np.array([[120.0, 121.0, 125.0]]), np.array([[2.0, 3.0, 1.0]]))
    view = regulator_view(settings, band, state)
    np.testing.assert_allclose(view.tap, [[0.5, -0.25, 0.5]])
    np.testing.assert_allclose(view.relay, [[0.5, -0.5, 0.0]])
    np.testing.assert_allclose(view.timer, [[0.5, 0.5, 1.0]], rtol=1e-5)


def test_settled_taps_stay_within_the_ends_and_at_the_beginning_where_nobody_controls_them():
    feeder = feeder_of(tap_max=(11, 8, 11), vreg_v=(126.0,) * 3)
    loads = feeder.p_load_kw[None], feeder.q_load_kvar[None]
    found = settled_taps(feeder, *loads)
    assert found.tap.tolist() == [[11.0, 8.0, 11.0]]
    assert found.settled.tolist() == [True]
    still = settled_taps(feeder, *loads, controlled=np.zeros(3))
    assert (still.tap.tolist(), still.settled.tolist(), still.rounds) == ([[10.0, 8.0, 11.0]], [True], 1)
