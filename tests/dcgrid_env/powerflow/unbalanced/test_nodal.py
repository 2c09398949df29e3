"""Nodal equations: on radial feeders they give what the sweep gives, and on others power is conserved."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dcgrid_env import FeederError, ThreePhaseFeeder, load_feeder
from dcgrid_env.grid import nodal_matrices
from dcgrid_env.grid.network import AdmittanceTable
from dcgrid_env.powerflow import PowerFlowError, branch_flows, solve_unbalanced
from dcgrid_env.powerflow.unbalanced import adjoint_batch, array_form
from dcgrid_env.powerflow.unbalanced.linearised import linearise
from dcgrid_env.powerflow.unbalanced.nodal import nodal_of
from helpers.nodal import as_nodal


@pytest.fixture(params=["ieee13-3ph", "ieee34-3ph", "ieee13-3ph, lines as couplers"])
def both(request, monkeypatch):
    """A radial feeder, and the same one with nodal equations."""
    name, _, couplers = request.param.partition(", ")
    if couplers:
        monkeypatch.setattr(nodal_matrices, "NEAR_ZERO", 1e9)
    radial = load_feeder(name)
    return radial, as_nodal(radial)


def test_voltages_currents_and_powers_are_the_sweeps(both, random_inputs, solved):
    radial, nodal = both
    inputs = random_inputs(radial, 40, 5)
    one, two = (solved(feeder, inputs, tolerance_pu=1e-11) for feeder in both)
    assert two.converged.all()
    assert nodal.node_ids == radial.node_ids
    np.testing.assert_array_equal(nodal.node_parent[6:], radial.node_parent[6:])  # behind the delta of the substation
    np.testing.assert_array_equal(nodal.rating_a, radial.rating_a)
    for field in ("v_re_pu", "v_im_pu"):
        np.testing.assert_allclose(getattr(two, field), getattr(one, field), atol=2e-9)
    for field in ("i_re_a", "i_im_a"):  # of regulators, whose ends have no charging of a line
        at_regulators = [getattr(s, field)[:, radial.regulated] for s in (two, one)]
        np.testing.assert_allclose(*at_regulators, atol=1e-3)
    for field in ("loss_kw", "source_p_kw", "source_q_kvar"):
        np.testing.assert_allclose(getattr(two, field), getattr(one, field), atol=1e-4)


def test_a_row_is_the_same_to_the_bit_alone_and_in_a_batch(both, random_inputs, solved):
    nodal = both[1]
    inputs = random_inputs(nodal, 40, 6)
    whole = solved(nodal, inputs)
    for row in (0, 33):
        alone = solved(nodal, type(inputs)(*(a[row : row + 1] for a in inputs)))
        for field in ("restart", "i_re_a", "loss_kw", "source_q_kvar", "iterations"):
            np.testing.assert_array_equal(getattr(alone, field)[0], getattr(whole, field)[row])


def test_a_warm_start_finds_the_same_solution(both, random_inputs, solved):
    nodal = both[1]
    inputs = random_inputs(nodal, 8, 7)
    cold = solved(nodal, inputs)
    warm = solved(nodal, inputs._replace(p_kw=1.001 * inputs.p_kw), start=cold)
    assert (warm.iterations <= cold.iterations).all()
    np.testing.assert_allclose(solved(nodal, inputs, start=warm).v_pu, cold.v_pu, atol=2e-8)


def test_the_derivative_is_the_sweeps(both, random_inputs, solved):
    inputs, rng = random_inputs(both[0], 10, 8), np.random.default_rng(2)
    inputs = inputs._replace(state=0.5 * inputs.state + 0.25)
    regulated = torch.tensor(both[0].regulated.copy())
    fields = ("v_pu", "v_re_pu", "v_im_pu", "loss_kw", "source_p_kw", "source_q_kvar", "i_re_a", "i_im_a")
    weights = {}
    found = []
    for feeder in both:
        given = type(inputs)(*(torch.tensor(a, requires_grad=True) for a in inputs))
        s, total = solved(feeder, given, tolerance_pu=1e-12), torch.zeros(())
        for field in fields:
            figure = getattr(s, field)
            figure = figure[:, regulated] if field.startswith("i_") else figure
            weights.setdefault(field, torch.tensor(rng.normal(size=figure.shape)))
            total = total + (weights[field] * figure).sum()
        found.append(torch.autograd.grad(total, given))
    for one, two in zip(*found, strict=True):
        torch.testing.assert_close(two, one, rtol=1e-6, atol=1e-7 * float(one.abs().max()))


def test_newtons_method_and_its_slopes_agree_with_the_iteration(both, random_inputs, solved):
    radial, nodal = both
    inputs = random_inputs(nodal, 2, 9)
    swept, by_newton = (solved(nodal, inputs, max_sweeps=most) for most in (1000, 1))
    assert by_newton.converged.all()
    np.testing.assert_allclose(by_newton.v_pu, swept.v_pu, atol=2e-8)
    slopes = [linearise(feeder, radial.p_load_kw, radial.q_load_kvar, nodes=[5, 9, 12]) for feeder in both]
    for one, two in zip(*slopes, strict=True):
        np.testing.assert_allclose(two, one, rtol=1e-6, atol=1e-7 * np.abs(one).max())


def test_devices_may_draw_anywhere(both, solved, random_inputs):
    """Each set of nodes with devices has its own layout of the factors, and all give the same voltages."""
    radial, nodal = both
    inputs = random_inputs(radial, 1, 10)
    for node in range(3, radial.n_node, 7):
        p_kw = inputs.p_kw.copy()
        p_kw[0, radial.first_device_leg + node] += 15.0
        one, two = (solved(feeder, inputs._replace(p_kw=p_kw)) for feeder in both)
        np.testing.assert_allclose(two.v_re_pu, one.v_re_pu, atol=2e-8)
        assert two.loss_kw == pytest.approx(one.loss_kw, abs=1e-3)
    everywhere = np.ones(nodal.n_node, bool)
    assert nodal_of(nodal) is nodal_of(nodal, everywhere)


@pytest.mark.parametrize("share", [0.0, 1e-12, 1e-7])
def test_lines_of_nearly_no_impedance_are_solved_as_the_sweep_does(share, solved, random_inputs):
    feeder = load_feeder("ieee13-3ph")
    line = feeder.network.phase_line
    small = line.name.index("632670")

    def scaled(matrices):
        return tuple(
            tuple(tuple(share * value for value in row) for row in matrix) if k == small else matrix
            for k, matrix in enumerate(matrices)
        )

    changed = replace(line, r_ohm=scaled(line.r_ohm), x_ohm=scaled(line.x_ohm))
    radial = ThreePhaseFeeder.from_network(replace(feeder.network, phase_line=changed))
    nodal = as_nodal(radial)
    assert (nodal.nodal.coupler_regulator < 0).sum() == 6  # the line and the switch
    inputs = random_inputs(radial, 4, 5)
    one, two = (solved(feeder, inputs, tolerance_pu=1e-11) for feeder in (radial, nodal))
    for field in ("v_re_pu", "v_im_pu"):
        np.testing.assert_allclose(getattr(two, field), getattr(one, field), atol=2e-9)
    np.testing.assert_allclose(two.loss_kw, one.loss_kw, atol=1e-4)


def test_a_loop_is_solved_and_conserves_power():
    feeder = load_feeder("ieee13-3ph")
    network = feeder.network
    line = network.phase_line
    row = line.name.index("671680")
    columns = {field: (*values, values[row]) for field, values in vars(line).items() if values}
    columns |= {"name": (*line.name, "tie"), "from_bus": (*line.from_bus, "632"), "to_bus": (*line.to_bus, "680")}
    meshed = ThreePhaseFeeder.from_network(replace(network, phase_line=type(line)(**columns)))
    assert not meshed.is_radial
    s = solve_unbalanced(meshed, meshed.p_load_kw, meshed.q_load_kvar)
    radial = solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    assert s.converged
    assert s.loss_kw < radial.loss_kw  # a second way for the same load
    assert s.v_pu.min() > radial.v_pu.min()
    p_legs = _drawn_kw(meshed, s)
    assert s.source_p_kw == pytest.approx(p_legs + s.loss_kw, abs=1e-3)
    with pytest.raises(PowerFlowError, match="radial feeders only"):
        branch_flows(meshed, s)
    with pytest.raises(PowerFlowError, match="only radial feeders are solved"):
        array_form.sweep_arrays(meshed, (), None, 1e-9, 10)


def test_a_regulator_within_a_loop_has_its_derivative(solved, random_inputs, monkeypatch):
    """It feeds no node alone, so its current follows from no other."""
    feeder = load_feeder("ieee13-3ph")
    table = feeder.network.regulator
    row = {field: values[0] for field, values in vars(table).items() if values}
    row |= {"name": "tie", "bank": "tie", "from_bus": "675", "to_bus": "680", "phases": "abc", "x_percent": 6.0}
    more = {field: (*values, row[field]) for field, values in vars(table).items() if values}
    meshed = ThreePhaseFeeder.from_network(replace(feeder.network, regulator=type(table)(**more)))
    assert meshed.n_regulator - 1 not in meshed.node_regulator
    inputs = random_inputs(meshed, 2, 12)
    ratio = torch.tensor(meshed.tap_ratio(np.full((2, meshed.n_regulator), 2.0)), requires_grad=True)
    for method in ("sweeps", "newton"):
        if method == "newton":
            monkeypatch.setattr(adjoint_batch, "sweep_adjoint_rows", lambda *given: given[8].fill(False) or 0)
        given = type(inputs)(*(torch.tensor(a) for a in inputs))._replace(ratio=ratio)
        s = solved(meshed, given, tolerance_pu=1e-11)
        (found,) = torch.autograd.grad(s.loss_kw.sum() + s.v_pu.sum(), ratio)
        moved = []
        for step in (1e-5, -1e-5):
            other = ratio.detach().numpy().copy()
            other[:, -1] += step
            t = solved(meshed, inputs._replace(ratio=other), tolerance_pu=1e-11)
            moved.append(t.loss_kw + t.v_pu.sum(-1))
        np.testing.assert_allclose(found[:, -1], (moved[0] - moved[1]) / 2e-5, rtol=1e-5)


def _drawn_kw(feeder, solution):
    """Power that the loads draw at a solution, by their law."""
    legs = feeder.load_legs
    v = np.append(solution.v_re_pu + 1j * solution.v_im_pu, 0.0)
    u = np.abs(v[legs.node] - v[legs.other]) / legs.rated_pu
    z, i, c = legs.share[:3]
    assert (u > legs.limit_pu[1]).all()
    within = np.minimum(u, legs.limit_pu[2])
    return (legs.p_kw * (z + i / within + c / within**2) * u**2).sum()


@pytest.mark.parametrize(("kind", "columns"), [
    ("transformer", {"r_percent": (0.0, 0.0), "x_percent": (0.0, 0.0)}),
    ("source", {"r_ohm": [((0.0,) * 3,) * 3], "x_ohm": [((0.0,) * 3,) * 3]}),
])  # fmt: skip
def test_an_impedance_of_zero_is_named(kind, columns):
    network = as_nodal(load_feeder("ieee13-3ph")).network
    changed = replace(network, **{kind: replace(getattr(network, kind), **columns)})
    with pytest.raises(FeederError, match=rf"{kind}.*: its impedance is 0 or singular"):
        ThreePhaseFeeder.from_network(changed)


def test_a_part_without_ground_is_named():
    feeder = load_feeder("ieee13-3ph")
    network, node = feeder.network, feeder.network.node
    isolated = {field: (*values, values[-1]) for field, values in vars(node).items() if values}
    isolated |= {"bus": (*node.bus, "far"), "phase": (*node.phase, 1)}
    nodes = ("671.a far.a",)
    y = AdmittanceTable(("coupling",), ("capacitor",), nodes, ((0.0, 0.0, 0.0),), ((0.0, 0.0, 0.0),))
    with pytest.raises(FeederError, match=r"no element connects the nodes \['far.a'\] to the source"):
        ThreePhaseFeeder.from_network(replace(network, node=type(node)(**isolated), admittance=y))
    delta = replace(y, nodes=("671.a far.a far.b",), g_s=((0.0,) * 6,), b_s=((0.0, 0.0, 0.0, -1.0, 1.0, -1.0),))
    two = {field: (*values, values[-1]) for field, values in isolated.items()} | {
        "bus": (*isolated["bus"], "far"), "phase": (*isolated["phase"], 2)
    }  # fmt: skip
    coupled = replace(delta, b_s=((-1e-30, 1e-30, 0.0, -1.0, 1.0, -1.0),))
    feeder = ThreePhaseFeeder.from_network(replace(network, node=type(node)(**two), admittance=coupled))
    with pytest.raises(FeederError, match=r"node far\..* has no connection to ground|no unique solution"):
        solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar)


def test_a_regulator_that_is_fed_at_its_to_bus_is_named():
    network = as_nodal(load_feeder("ieee34-3ph")).network
    table = network.regulator
    turned = replace(table, from_bus=table.to_bus, to_bus=table.from_bus)
    with pytest.raises(FeederError, match=r"no element connects the nodes .* or turn the regulator whose to_bus is on"):
        ThreePhaseFeeder.from_network(replace(network, regulator=turned))
