"""The control of regulators over time: delays, the band, the ends, steps of any length, tensors, rows."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dcgrid_env import ThreePhaseFeeder, load_feeder
from dcgrid_env.devices.tap_changer.relay import direction, relay_settings, relay_volts, settings_like
from dcgrid_env.devices.tap_changer.tap_control import control_taps, initial_regulators
from dcgrid_env.powerflow import Control, ThreePhaseSolution, solve_unbalanced

FEEDER = load_feeder("ieee13-3ph")
SETTINGS = relay_settings(FEEDER)
N = FEEDER.n_regulator
TAP_V = 0.75  # 0.00625 of 120 V


def state_at(volts, tap=0.0):
    return initial_regulators(np.full((1, N), float(tap)), np.array([volts], float))


def after_steps(state, dt_s, steps):
    """The taps after each step, under the volts that the control itself predicts."""
    taps = []
    for _ in range(steps):
        state = control_taps(SETTINGS, state, dt_s)
        taps.append(state.tap[0, 0])
    return np.array(taps), state


def test_relay_volts_worked_by_hand():
    """|120 V x 1.02 - (3 + 9j) x (350 - 100j) / 700| on phase a of IEEE 13, whose base is 2401.777 V a 20 turns."""
    node, n = SETTINGS.node[0], FEEDER.n_node
    v, i_re, i_im = np.zeros((3, 1, n))
    v[0, node], i_re[0, node], i_im[0, node] = 1.02, 350.0, -100.0
    solution = ThreePhaseSolution(**dict.fromkeys(ThreePhaseSolution._fields, None))
    solution = solution._replace(v_re_pu=v, v_im_pu=0.0 * v, i_re_a=i_re, i_im_a=i_im)
    volts = 1.02 * 2401.77711983 / 20.0
    expected = abs(volts - (3.0 + 9.0j) * (350.0 - 100.0j) / 700.0)
    assert relay_volts(SETTINGS, solution)[0, 0] == pytest.approx(expected, rel=1e-9)
    assert expected == pytest.approx(119.77, abs=0.01)


@pytest.mark.parametrize(
    ("missing_v", "tap", "expected"),
    [(0.99, 0, 0), (1.01, 0, 1), (-0.99, 0, 0), (-1.01, 0, -1), (5.0, 16, 0), (-5.0, -16, 0), (-5.0, 16, -1)],
)
def test_band_and_ends(missing_v, tap, expected):
    volts = np.full((1, N), 122.0 - missing_v)
    assert (direction(SETTINGS, volts, np.full((1, N), float(tap))) == expected).all()


def test_a_relay_set_closer_than_a_tap_does_not_hunt():
    network = FEEDER.network
    closer = ThreePhaseFeeder.from_network(replace(network, regulator=replace(network.regulator, band_v=(0.1,) * N)))
    settings = relay_settings(closer)
    np.testing.assert_allclose(settings.half_band_v, 0.5 * TAP_V)
    assert (control_taps(settings, state_at([121.5] * N), 3600.0).moves == 1.0).all()


@pytest.mark.parametrize("dt_s", [0.1, 0.5, 1.0])
def test_first_delay_then_the_shorter_one(dt_s):
    state = state_at([122.0 - 3.0, 122.0, 122.0])  # back in band after three taps
    taps, last = after_steps(state, dt_s, round(25.0 / dt_s))
    times = dt_s * (1 + np.flatnonzero(np.diff(np.concatenate(([0.0], taps)))))
    np.testing.assert_allclose(times, [15.0, 17.0, 19.0])
    assert last.tap.tolist() == [[3.0, 0.0, 0.0]]
    assert last.moves.tolist() == [[3.0, 0.0, 0.0]]
    np.testing.assert_allclose(last.since_s, [[6.0, 25.0, 25.0]])
    assert (last.out_of_band_s == 0.0).all()
    assert (last.in_sequence == 0.0).all()


def test_back_in_band_resets_the_clock():
    state = control_taps(SETTINGS, state_at([119.0] * N), 14.0)
    assert (state.out_of_band_s == 14.0).all()
    state = control_taps(SETTINGS, state._replace(relay_v=np.full((1, N), 122.5)), 1.0)
    assert (state.out_of_band_s == 0.0).all()
    state = control_taps(SETTINGS, state._replace(relay_v=np.full((1, N), 119.0)), 14.0)
    assert (state.moves == 0.0).all()
    assert (control_taps(SETTINGS, state, 1.0).tap == 1.0).all()


def test_the_sequence_goes_on_over_steps():
    state = control_taps(SETTINGS, state_at([110.0] * N), 15.0)
    assert (state.tap == 1.0).all()
    assert (control_taps(SETTINGS, state, 1.0).moved == 0.0).all()
    assert (control_taps(SETTINGS, control_taps(SETTINGS, state, 1.0), 1.0).tap == 2.0).all()


def test_no_tap_beyond_the_ends_however_long_the_step():
    low, high = (control_taps(SETTINGS, state_at([volts] * N), 3600.0) for volts in (60.0, 200.0))
    assert (low.tap == 16.0).all()
    assert (high.tap == -16.0).all()
    assert (high.moved == 16.0).all()


@pytest.mark.parametrize("dt_s", [0.1, 7.0, 60.0, 300.0])
@pytest.mark.parametrize("multiplier", [0.5, 1.3])
def test_long_steps_end_within_a_tap_of_short_ones(dt_s, multiplier):
    """In truth, which differs from what is predicted within a step, and with regulators in series."""
    feeder = load_feeder("ieee34-3ph")
    settings = relay_settings(feeder)
    p, q = multiplier * feeder.p_load_kw[None], multiplier * feeder.q_load_kvar[None]

    def measured(tap):
        return relay_volts(settings, solve_unbalanced(feeder, p, q, control=Control(feeder.tap_ratio(tap))))

    ends = []
    for length in (1.0, dt_s):
        tap = feeder.base_tap[None]
        state = initial_regulators(tap, measured(tap))
        for _ in range(round(900.0 / length) if length >= 1.0 else 600):
            state = control_taps(settings, state, length)
            state = state._replace(relay_v=measured(state.tap))
        ends.append(state)
    assert np.abs(ends[0].tap - ends[1].tap).max() <= 1.0
    assert (direction(settings, ends[1].relay_v, ends[1].tap) == 0.0).all()


def test_a_regulator_further_down_is_predicted_to_move_too():
    feeder = load_feeder("ieee123-3ph")
    settings, names = relay_settings(feeder), list(feeder.network.regulator.name)
    first, last = names.index("creg1a"), names.index("creg4b")
    assert settings.volts_per_tap[first, last] == pytest.approx(0.75, abs=1e-3)
    assert settings.volts_per_tap[last, first] == 0.0
    assert settings.volts_per_tap[names.index("creg4a"), last] == 0.0  # another phase


def test_who_is_not_controlled_stays():
    state = control_taps(SETTINGS, state_at([110.0] * N), 60.0, np.array([1.0, 0.0, 1.0]))
    assert (state.tap[0] != 0.0).tolist() == [True, False, True]


def random_states(n_row):
    rng = np.random.default_rng(0)
    shape = (n_row, N)
    tap, volts = rng.integers(-16, 17, shape).astype(float), rng.normal(122.0, 4.0, shape)
    waited = rng.uniform(0.0, 20.0, shape)
    return initial_regulators(tap, volts)._replace(out_of_band_s=waited, in_sequence=(waited < 2.0) * 1.0)


@pytest.mark.parametrize("dt_s", [0.1, 1.0, 30.0])
def test_rows_and_tensors_have_the_same_bits(dt_s):
    many = random_states(64)
    together = control_taps(SETTINGS, many, dt_s)
    for row in (0, 17, 63):
        alone = control_taps(SETTINGS, type(many)(*(a[row : row + 1] for a in many)), dt_s)
        for one, all_of_them in zip(alone, together, strict=True):
            np.testing.assert_array_equal(one[0], all_of_them[row])
    tensors = type(many)(*map(torch.from_numpy, many))
    on_tensors = control_taps(settings_like(SETTINGS, tensors.tap), tensors, dt_s)
    for of_tensor, of_array in zip(on_tensors, together, strict=True):
        np.testing.assert_array_equal(of_tensor.numpy(), of_array)
