"""What any three-phase power flow must obey, cases worked by hand, and the balanced DistFlow."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env import ThreePhaseFeeder, distflow, load_feeder
from dcgrid_env.grid.network import Network, NodeTable, PhaseLineTable, PhaseLoadTable, SourceTable
from dcgrid_env.grid.three_phase_matrices import PHASE_BASE_KVA
from dcgrid_env.powerflow import Control, branch_flows, solve_unbalanced
from helpers.feeders import BALANCED, THREE_PHASE

NOTHING = ((0.0,) * 3,) * 3
NEXT = {"a": "b", "b": "c", "c": "a"}


def law(legs, v):
    """Currents of legs at v p.u., straight from the docstring of ``grid.three_phase_legs``."""
    across = v[legs.node] - np.where(legs.other >= 0, v[legs.other], 0.0)
    u, (low, vmin, vmax) = np.abs(across) / legs.rated_pu, legs.limit_pu
    found = []
    for z, i, c in (legs.share[:3], legs.share[3:]):
        inside = np.clip(u, vmin, vmax)
        h = z + i / inside + c / inside**2
        slope = (h * vmin - low) / (vmin - low)
        h = np.where(u < vmin, slope + (1.0 - slope) * low / u, h)
        found.append(np.where((u < low) | (z == 1.0), 1.0, h))
    return across / legs.rated_pu**2 / PHASE_BASE_KVA, *found


def drawn(feeder, p_kw, q_kvar, state, v):
    """Current out of each node, p.u."""
    n_load, out = feeder.first_device_leg, np.conj((p_kw + 1j * q_kvar)[feeder.first_device_leg :] / PHASE_BASE_KVA / v)
    for legs, p, q in (
        (feeder.load_legs, p_kw[:n_load], q_kvar[:n_load]),
        (feeder.capacitor_legs, 0.0, feeder.capacitor_legs.q_kvar * state[feeder.capacitor_legs.row]),
    ):
        unit, h_p, h_q = law(legs, v)
        current = (p * h_p - 1j * q * h_q) * unit
        np.add.at(out, legs.node, current)
        np.subtract.at(out, legs.other[legs.other >= 0], current[legs.other >= 0])
    for i in range(feeder.n_bus):
        at = slice(feeder.first_node[i], feeder.first_node[i + 1])
        size = at.stop - at.start
        out[at] += 1j * feeder.branches.shunt[i, :size, :size] @ v[at]
    return out


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(THREE_PHASE), st.integers(0, 2**31), st.floats(0.0, 1.3))
def test_kirchhoff_at_every_node_and_branch(name, seed, scale):
    feeder, rng = load_feeder(name), np.random.default_rng(seed)
    p_kw = feeder.p_load_kw * rng.uniform(0.0, scale, feeder.n_leg) + rng.normal(0.0, 3.0, feeder.n_leg)
    q_kvar = feeder.q_load_kvar * rng.uniform(-scale, scale, feeder.n_leg) + rng.normal(0.0, 3.0, feeder.n_leg)
    tap, state = rng.integers(-8, 9, feeder.n_regulator), rng.integers(0, 2, feeder.n_capacitor)
    ratio = feeder.tap_ratio(tap.astype(float))
    control = Control(tap_ratio=ratio, capacitor_on=state)
    s = solve_unbalanced(feeder, p_kw, q_kvar, 1.01, control, tolerance_pu=1e-11)
    v, i_a, n_load = s.v_re_pu + 1j * s.v_im_pu, s.i_re_a + 1j * s.i_im_a, feeder.first_device_leg
    current = i_a / (PHASE_BASE_KVA / feeder.base_kv_ln[feeder.node_bus])
    left = current - drawn(feeder, p_kw, q_kvar, state, v)
    flows, entered = branch_flows(feeder, s, control), 0.0
    for k in range(1, feeder.n_bus):
        at = slice(feeder.first_node[k], feeder.first_node[k + 1])
        size, up = at.stop - at.start, feeder.node_parent[at]
        tapped = feeder.branches.regulator[k, :size]
        r = np.where(tapped >= 0, ratio[tapped], 1.0) if feeder.n_regulator else np.ones(size)
        a, b = r[:, None] * feeder.branches.a[k, :size, :size], feeder.branches.b[k, :size, :size] * r * r
        np.testing.assert_allclose(v[at], a @ v[up] - b @ current[at], rtol=0.0, atol=1e-11)
        left[up] -= a.T @ current[at]
        entered += flows.p_kw[k - 1].sum() - (v[at] * np.conj(current[at])).real.sum() * PHASE_BASE_KVA
    assert np.abs(v * np.conj(left)).max() * PHASE_BASE_KVA < 1e-5  # kVA
    unit, h_p, _ = law(feeder.load_legs, v)
    across = unit * feeder.load_legs.rated_pu**2 * PHASE_BASE_KVA
    taken = (p_kw[:n_load] * h_p * np.abs(across / feeder.load_legs.rated_pu) ** 2).sum() + p_kw[n_load:].sum()
    assert s.source_p_kw - taken == pytest.approx(s.loss_kw, abs=1e-3)
    assert entered == pytest.approx(s.loss_kw, abs=1e-3)


def turned(network):
    """The same grid with phase a called b, b called c and c called a."""

    def phases(text):
        return "".join(sorted(NEXT[p] for p in text))

    def matrix(m):
        return tuple(tuple(m[(i + 2) % 3][(j + 2) % 3] for j in range(3)) for i in range(3))

    def legs(values):
        return (values[2], values[0], values[1])

    def column(table, **how):
        return replace(table, **{field: [f(value) for value in getattr(table, field)] for field, f in how.items()})

    node = network.node
    order = sorted(range(len(node)), key=lambda k: (node.bus.index(node.bus[k]), node.phase[k] % 3))
    return replace(
        network,
        node=NodeTable([node.bus[k] for k in order], [node.phase[k] % 3 + 1 for k in order],
                       *([getattr(node, f)[k] for k in order] for f in ("x", "y", "base_kv_ln"))),
        phase_line=column(network.phase_line, phases=phases, r_ohm=matrix, x_ohm=matrix, b_us=matrix),
        switch=column(network.switch, phases=phases),
        regulator=column(network.regulator, phases=phases, sensed_phase=NEXT.get),
        phase_load=column(network.phase_load, p_kw=legs, q_kvar=legs),
        capacitor=column(network.capacitor, kvar=legs),
    )  # fmt: skip


@pytest.mark.parametrize("name", THREE_PHASE)
def test_names_of_phases_are_names_alone(name):
    one = load_feeder(name)
    two = ThreePhaseFeeder.from_network(turned(one.network))
    s, t = (solve_unbalanced(f, f.p_load_kw, f.q_load_kvar, tolerance_pu=1e-11) for f in (one, two))
    place = {(two.bus_ids[b], p): k for k, (b, p) in enumerate(zip(two.node_bus, two.node_phase, strict=True))}
    same = [place[one.bus_ids[b], p % 3 + 1] for b, p in zip(one.node_bus, one.node_phase, strict=True)]
    np.testing.assert_allclose(t.v_pu[same], s.v_pu, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(t.i_a[same], s.i_a, rtol=1e-7, atol=1e-6)
    assert t.loss_kw == pytest.approx(s.loss_kw, abs=1e-6)


def three_phase_of(feeder):
    """A balanced feeder as three phases without coupling, its loads constant power without limits."""
    kv_ln, n = feeder.base_kv / math.sqrt(3.0), feeder.n_bus
    names = [f"{k}" for k in range(n - 1)]

    def diagonal(values) -> list[Any]:
        return [np.diag([value] * 3) for value in values.tolist()]

    def thirds(values):
        return [[value / 3.0] * 3 for value in values.tolist()]

    network = Network(
        name="three phases",
        source=SourceTable([feeder.bus_ids[0]], [feeder.base_kv], [1.0], [0.0], [NOTHING], [NOTHING]),
        node=NodeTable(
            np.repeat(feeder.bus_ids, 3).tolist(), [1, 2, 3] * n, [0.0] * 3 * n, [0.0] * 3 * n, [kv_ln] * 3 * n
        ),
        phase_line=PhaseLineTable(
            names, [feeder.bus_ids[i] for i in feeder.parent], feeder.bus_ids[1:], ["abc"] * (n - 1), [1.0] * (n - 1),
            diagonal(feeder.r_ohm), diagonal(feeder.x_ohm), [NOTHING] * (n - 1),
        ),
        phase_load=PhaseLoadTable(
            feeder.bus_ids, feeder.bus_ids, ["wye"] * n, ["PQ"] * n, [kv_ln] * n, thirds(feeder.p_load_kw),
            thirds(feeder.q_load_kvar), [0.02] * n, [9.0] * n, [0.01] * n, [()] * n,
        ),
    )  # fmt: skip
    return ThreePhaseFeeder.from_network(network)


@pytest.mark.parametrize("name", BALANCED)
def test_a_balanced_feeder_in_three_phases_is_distflow(name):
    feeder = load_feeder(name)
    three, scale = three_phase_of(feeder), np.linspace(0.2, 1.2, 11)[:, None]
    one = distflow(feeder, scale * feeder.p_load_kw, scale * feeder.q_load_kvar, 1.03, tolerance_kva=1e-9)
    two = solve_unbalanced(three, scale * three.p_load_kw, scale * three.q_load_kvar, 1.03, tolerance_pu=1e-12)
    assert one.converged.all() == two.converged.all() is np.True_
    bus = [feeder.index(three.bus_ids[i]) for i in three.node_bus]
    np.testing.assert_allclose(two.v_pu, one.v_pu[:, bus], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(two.loss_kw, one.loss_kw, rtol=1e-7)


def two_nodes(r_ohm=0.5, x_ohm=1.0):
    """Source bus 0 of three phases, 1 kV to neutral, and bus 1 on phase b alone."""
    only_b = [[math.nan] * 3 for _ in range(3)]
    r, x, b = (
        tuple(tuple(v if i == j == 1 else math.nan for j in range(3)) for i in range(3)) for v in (r_ohm, x_ohm, 0.0)
    )
    del only_b
    return ThreePhaseFeeder.from_network(
        Network(
            name="two",
            source=SourceTable([0], [math.sqrt(3.0)], [1.0], [0.0], [NOTHING], [NOTHING]),  # pyright: ignore
            node=NodeTable(["0", "0", "0", "1"], [1, 2, 3, 2], [0.0] * 4, [0.0] * 4, [1.0] * 4),
            phase_line=PhaseLineTable(["l"], ["0"], ["1"], ["b"], [1.0], [r], [x], [b]),
        )
    )


@pytest.mark.parametrize(("p_kw", "q_kvar"), [(100.0, 50.0), (-80.0, 20.0), (200.0, 0.0), (0.0, 0.0)])
def test_two_nodes_by_hand(p_kw, q_kvar):
    # v^4 + (2 (r p + x q) - 1) v^2 + (r^2 + x^2) (p^2 + q^2) = 0 on 1 kV and 1 MVA a phase.
    r, x, p, q = 0.5, 1.0, p_kw / 1e3, q_kvar / 1e3
    half = 0.5 - (r * p + x * q)
    v_pu = math.sqrt(half + math.sqrt(half * half - (r * r + x * x) * (p * p + q * q)))
    feeder = two_nodes(r, x)
    powers = np.zeros((2, feeder.n_leg))
    powers[:, -1] = p_kw, q_kvar
    solution = solve_unbalanced(feeder, powers[0], powers[1], tolerance_pu=1e-12)
    assert solution.v_pu == pytest.approx([1.0, 1.0, 1.0, v_pu], abs=1e-10)
    assert solution.i_a[3] == pytest.approx(math.hypot(p_kw, q_kvar) / v_pu, abs=1e-6)
    assert solution.loss_kw == pytest.approx(r * (p * p + q * q) / v_pu**2 * 1e3, abs=1e-6)
    assert solution.v_angle_deg[1] == pytest.approx(-120.0)


@pytest.mark.slow
def test_up_to_the_collapse_and_past_it():
    feeder = two_nodes(0.5, 0.0)  # carries p up to 1 / (4 r) = 0.5 MW
    p_kw = np.zeros((40, feeder.n_leg))
    p_kw[:, -1] = np.linspace(480.5, 519.5, 40)
    solution = solve_unbalanced(feeder, p_kw, np.zeros_like(p_kw))
    assert solution.converged.tolist() == (p_kw[:, -1] < 500.0).tolist()
    exact = 0.5 + np.sqrt(np.maximum(0.25 - 0.5e-3 * p_kw[:, -1], 0.0))
    np.testing.assert_allclose(solution.v_pu[:20, -1], exact[:20], rtol=0.0, atol=1e-6)
    for figures in solution[:8]:
        assert np.isfinite(figures).all()
    assert not np.isnan(solution.residual_kva).any()


@pytest.mark.parametrize("name", THREE_PHASE)
@pytest.mark.parametrize("size_kw", [2e3, 2e4, 3e5, -3e5])
@pytest.mark.slow
def test_impossible_loads_are_no_error_and_never_a_nan(name, size_kw):
    feeder = load_feeder(name)
    p_kw, q_kvar = np.tile(feeder.p_load_kw, (40, 1)), np.tile(feeder.q_load_kvar, (40, 1))
    p_kw[20:, feeder.first_device_leg + np.arange(3, feeder.n_node)] = size_kw
    solution = solve_unbalanced(feeder, p_kw, q_kvar, max_sweeps=200)
    assert solution.converged[:20].all()
    assert not solution.converged[20:].any()
    for figures in (*solution[:8], solution.restart):
        assert np.isfinite(figures).all()
    again = solve_unbalanced(feeder, p_kw[::-1].copy(), q_kvar, start=solution.restart, max_sweeps=200)
    assert again.converged.tolist() == solution.converged[::-1].tolist()
