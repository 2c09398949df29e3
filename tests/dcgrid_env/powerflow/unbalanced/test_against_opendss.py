"""The sweep against OpenDSS itself, on a circuit made of our tables, at random points up to near the collapse."""

from dataclasses import replace

import numpy as np
import pytest

from dcgrid_env import ThreePhaseFeeder, load_feeder
from dcgrid_env.powerflow import Control, solve_unbalanced
from docs.studies.speed.opendss_circuit import OpenDss
from helpers.feeders import THREE_PHASE

pytest.importorskip("dss", reason="OpenDSSDirect.py is not installed (the extra test has it)")

POINTS, HEAVY = 200, 50
V_PU, KW = 1e-6, 1e-2
MODELS = ("PQ", "I", "Z", "CVR", "ZIP")


def grounded_legs(feeder):
    """Devices' legs that OpenDSS can draw from too: not behind a delta, where nothing holds the neutral point."""
    table = feeder.network.transformer
    deltas = [bus for bus, winding in zip(table.to_bus, table.connection_to, strict=True) if winding == "delta"]
    nodes = [n for n in range(3, feeder.n_node) if feeder.bus_ids[feeder.node_bus[n]] not in deltas]
    return feeder.first_device_leg + np.array(nodes)


def points(feeder, seed):
    """Random loads, taps, capacitors, injections; the last ``HEAVY`` carry one load at 0.98 of what they can."""
    rng = np.random.default_rng(seed)
    p_kw = feeder.p_load_kw * rng.uniform(0.0, 1.3, (POINTS, feeder.n_leg))
    q_kvar = feeder.q_load_kvar * rng.uniform(-0.3, 1.3, (POINTS, feeder.n_leg))
    legs, rows = grounded_legs(feeder), np.arange(POINTS)
    for _ in range(6):
        leg, size = rng.choice(legs, POINTS), rng.uniform(0.0, 60.0, POINTS)
        p_kw[rows, leg] += size * rng.uniform(-1.0, 1.0, POINTS)
        q_kvar[rows, leg] += size * rng.uniform(-1.0, 1.0, POINTS)
    table = feeder.network.regulator
    tap = rng.integers(table.tap_min, np.array(table.tap_max) + 1, (POINTS, feeder.n_regulator))
    tap[: POINTS // 2] = np.clip(feeder.base_tap + rng.integers(-3, 4, (POINTS // 2, feeder.n_regulator)), -16, 16)
    tap[-HEAVY:] = feeder.base_tap
    state = rng.integers(0, 2, (POINTS, feeder.n_capacitor)).astype(float)
    source_pu, ratio = rng.uniform(0.97, 1.03, POINTS), feeder.tap_ratio(tap.astype(float))
    leg = rng.choice(legs, HEAVY)
    most = np.zeros(HEAVY)
    for step in 40000.0 * 0.5 ** np.arange(14):  # by halves, the largest that the sweep can carry
        tried = p_kw[-HEAVY:].copy()
        tried[np.arange(HEAVY), leg] += most + step
        control = Control(tap_ratio=ratio[-HEAVY:], capacitor_on=state[-HEAVY:])
        most += step * solve_unbalanced(feeder, tried, q_kvar[-HEAVY:], source_pu[-HEAVY:], control).converged
    p_kw[np.arange(POINTS - HEAVY, POINTS), leg] += 0.98 * most
    return p_kw, q_kvar, source_pu, ratio, state


def within_cvr_limits(feeder, v_pu):
    """Whether all loads of the model CVR are within their limits, by point.

    Beyond them OpenDSS jumps to the law that a constant power has there; ours is continuous.
    """
    legs = feeder.load_legs
    cvr = np.flatnonzero([feeder.network.phase_load.model[row] == "CVR" for row in legs.row])
    across = v_pu[:, legs.node[cvr]] - np.where(legs.other[cvr] >= 0, v_pu[:, legs.other[cvr]], 0.0)
    u = np.abs(across) / legs.rated_pu[cvr]
    return ((u > legs.limit_pu[1, cvr]) & (u < legs.limit_pu[2, cvr])).all(axis=1)


def compare(feeder, seed, at_least):
    p_kw, q_kvar, source_pu, ratio, state = points(feeder, seed)
    control = Control(tap_ratio=ratio, capacitor_on=state)
    ours = solve_unbalanced(feeder, p_kw, q_kvar, source_pu, control)
    assert ours.converged.all()
    v_pu, circuit = ours.v_re_pu + 1j * ours.v_im_pu, OpenDss(feeder)
    good = np.flatnonzero(within_cvr_limits(feeder, v_pu))
    assert len(good) >= at_least
    for k in good:
        theirs, loss_kw, p, q = circuit.solve(p_kw[k], q_kvar[k], source_pu[k], ratio[k], state[k])
        np.testing.assert_allclose(v_pu[k], theirs, rtol=0.0, atol=V_PU, err_msg=f"point {k}")
        assert ours.loss_kw[k] == pytest.approx(loss_kw, abs=KW)
        assert (ours.source_p_kw[k], ours.source_q_kvar[k]) == pytest.approx((p, q), abs=KW)
    return ours


@pytest.mark.slow
@pytest.mark.parametrize("name", THREE_PHASE)
def test_random_points(name):
    ours = compare(load_feeder(name), 20, 60)
    assert ours.v_pu.min() < 0.75  # points near the collapse are among them, and loads beyond their limits
    assert ours.v_pu.max() > 1.12


@pytest.mark.slow
def test_every_model_of_load_within_and_beyond_its_limits():
    network = load_feeder("ieee13-3ph").network
    table = network.phase_load
    models = [MODELS[k % len(MODELS)] for k in range(len(table))]
    zips = [(0.3, 0.5, 0.2, 0.6, -0.2, 0.6) if model == "ZIP" else () for model in models]
    mixed = replace(table, model=models, zip=zips)
    compare(ThreePhaseFeeder.from_network(replace(network, phase_load=mixed)), 21, 20)
