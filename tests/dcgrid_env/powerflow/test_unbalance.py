"""Unbalance of voltages that can be worked by hand."""

import numpy as np
import pytest
import torch

from dcgrid_env import load_feeder
from dcgrid_env.powerflow import nema_unbalance, three_phase_nodes, unbalance_factor

FEEDER = load_feeder("ieee13-3ph")
NODES = three_phase_nodes(FEEDER)


def voltages(a: complex, b: complex, c: complex) -> tuple[np.ndarray, np.ndarray]:
    """The same three phasors at every bus."""
    phasor = np.array([a, b, c], np.complex128)[FEEDER.node_phase - 1]
    return np.real(phasor), np.imag(phasor)


TURN = np.exp(2j * np.pi / 3)


def test_buses_of_three_phases():
    assert {FEEDER.bus_ids[FEEDER.node_bus[row[0]]] for row in NODES} == {
        "650", "rg60", "632", "633", "634", "670", "671", "680", "692", "675"
    }  # fmt: skip
    assert (FEEDER.node_phase[NODES] == [1, 2, 3]).all()


def test_a_balanced_set_has_none():
    given = voltages(1.02, 1.02 * TURN**2, 1.02 * TURN)
    assert unbalance_factor(NODES, *given) == pytest.approx(0.0, abs=1e-12)
    assert nema_unbalance(NODES, *given) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.05])
def test_a_negative_sequence_of_known_size(share):
    given = voltages(1.0 + share, TURN**2 + share * TURN, TURN + share * TURN**2)
    assert unbalance_factor(NODES, *given) == pytest.approx(share, abs=1e-9)
    zero_sequence = voltages(1.1 + share, 0.1 + TURN**2 + share * TURN, 0.1 + TURN + share * TURN**2)
    assert unbalance_factor(NODES, *zero_sequence) == pytest.approx(share, abs=1e-9)
    assert nema_unbalance(NODES, *zero_sequence) == pytest.approx(nema_unbalance(NODES, *given))


def test_nema_by_hand():
    # One phase 3 % high: |Vab| = |Vca| = sqrt(1.03^2 + 1.03 + 1), |Vbc| = sqrt(3).
    lines = np.array([np.sqrt(1.03**2 + 1.03 + 1.0)] * 2 + [np.sqrt(3.0)])
    expected = np.abs(lines - lines.mean()).max() / lines.mean()
    assert nema_unbalance(NODES, *voltages(1.03, TURN**2, TURN)) == pytest.approx(expected)


def test_tensors_alike_and_no_voltage_is_no_unbalance():
    re, im = np.random.default_rng(0).uniform(-1.1, 1.1, (2, 3, FEEDER.n_node))
    for measure in (unbalance_factor, nema_unbalance):
        np.testing.assert_allclose(measure(NODES, re, im), measure(NODES, torch.tensor(re), torch.tensor(im)))
        np.testing.assert_array_equal(measure(NODES, 0.0 * re, 0.0 * im), 0.0)
