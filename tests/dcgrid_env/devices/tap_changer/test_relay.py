"""Relays of regulators: volts with line-drop compensation, the band, the ends, regulators in series."""

from dataclasses import replace

import numpy as np
import pytest

from dcgrid_env import ThreePhaseFeeder, load_feeder
from dcgrid_env.devices.tap_changer.relay import direction, relay_settings, relay_volts
from dcgrid_env.powerflow import ThreePhaseSolution

FEEDER = load_feeder("ieee13-3ph")
SETTINGS = relay_settings(FEEDER)
N = FEEDER.n_regulator
TAP_V = 0.75  # 0.00625 of 120 V


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


def test_half_a_band_is_at_least_half_a_tap():
    network = FEEDER.network
    closer = ThreePhaseFeeder.from_network(replace(network, regulator=replace(network.regulator, band_v=(0.1,) * N)))
    np.testing.assert_allclose(relay_settings(closer).half_band_v, 0.5 * TAP_V)


def test_a_tap_moves_the_volts_of_regulators_further_down_in_its_phase():
    feeder = load_feeder("ieee123-3ph")
    settings, names = relay_settings(feeder), list(feeder.network.regulator.name)
    first, last = names.index("creg1a"), names.index("creg4b")
    assert settings.volts_per_tap[first, last] == pytest.approx(0.75, abs=1e-3)
    assert settings.volts_per_tap[last, first] == 0.0
    assert settings.volts_per_tap[names.index("creg4a"), last] == 0.0  # another phase
