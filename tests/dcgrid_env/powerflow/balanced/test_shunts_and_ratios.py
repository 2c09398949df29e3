"""Shunts and transformer ratios: by hand, by phasors, against pandapower, and one answer of every form of the flow."""

import dataclasses

import numpy as np
import pandapower
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env import Feeder, distflow, lindistflow, load_feeder, own_sensitivity, sensitivity
from dcgrid_env.powerflow.balanced.implicit import distflow_tensors
from dcgrid_env.powerflow.balanced.prefix import distflow_arrays, lindistflow_arrays

EXACT_KVA = 1e-9


def with_shunts(name, seed=0, ratios=True):
    """A named feeder with a shunt at every bus, of a fifth of its load in all, and ratios from 0.9 to 1.1."""
    feeder, rng = load_feeder(name), np.random.default_rng(seed)
    size = 0.4 * feeder.p_load_kw.sum() / feeder.n_bus
    ratio = rng.uniform(0.9, 1.1, feeder.n_bus)
    ratio[0] = 1.0
    return dataclasses.replace(
        feeder,
        shunt_kw=size * rng.uniform(0.0, 1.0, feeder.n_bus),
        shunt_kvar=size * rng.uniform(-1.0, 2.0, feeder.n_bus),
        voltage_ratio=ratio if ratios else None,
    )


@pytest.fixture(params=["toy6", "ieee33", "khodr141"])
def shunted(request):
    return with_shunts(request.param)


def two_buses(r, x, g, b, ratio):
    """1 kV and 1 MVA, so that ohm is per unit; a shunt and a ratio at the second bus."""
    return Feeder.from_tables(
        name="two", base_kv=1.0, substation=0, v0_pu=1.0, bus_ids=[0, 1], p_load_kw=[0.0, 0.0], q_load_kvar=[0.0, 0.0],
        from_bus=[0], to_bus=[1], r_ohm=[r], x_ohm=[x], shunt_kw=[0.0, 1e3 * g], shunt_kvar=[0.0, 1e3 * b],
        voltage_ratio=[1.0, ratio],
    )  # fmt: skip


def rounded(value):
    """A figure that a feeder may have: none is below 1e-100 in size."""
    return round(value, 12)


@settings(deadline=None)
@given(
    p=st.floats(-1.0, 1.0), q=st.floats(-1.0, 1.0),
    g=st.floats(-0.5, 1.0).map(rounded), b=st.floats(-1.0, 1.0).map(rounded),
    ratio=st.floats(0.8, 1.2), v0=st.floats(0.95, 1.05),
)  # fmt: skip
@pytest.mark.slow
def test_two_buses_by_hand(p, q, g, b, ratio, v0):
    # Thevenin: the shunt y = g + jb behind z = r + jx divides both the source and z by 1 + z y; what is left is a
    # load alone, whose squared voltage w solves w^2 + w (2 Re(z' s*) - |v'|^2) + |z'|^2 |s|^2 = 0.
    z, s = complex(0.03, 0.06), complex(p, q)
    divided = 1.0 + z * complex(g, b)
    z_seen, v_seen = z / divided, v0 / abs(divided)
    half = 0.5 * (v_seen**2 - 2.0 * (z_seen * s.conjugate()).real)
    w = half + np.sqrt(half**2 - abs(z_seen) ** 2 * abs(s) ** 2)
    loads = [0.0, 1e3 * p], [0.0, 1e3 * q]
    feeder = two_buses(z.real, z.imag, g, b, ratio)
    for solution in (
        distflow(feeder, *loads, v0, tolerance_kva=EXACT_KVA),
        distflow_arrays(
            feeder,
            *(torch.tensor(a, dtype=torch.float64) for a in (*loads, v0)),
            warm=None,
            tolerance=1e-3 * EXACT_KVA,
            max_sweeps=1000,
        ),
    ):
        assert bool(solution.converged)
        assert float(solution.v_pu[0]) == pytest.approx(v0, abs=1e-15)
        assert float(solution.v_pu[1]) == pytest.approx(ratio * np.sqrt(w), abs=1e-10)


def test_power_that_enters_is_drawn_by_loads_and_shunts_or_lost(shunted, random_loads):
    p_kw, q_kvar, v0_pu = random_loads(shunted, 21, seed=60)
    solution = distflow(shunted, p_kw, q_kvar, v0_pu, tolerance_kva=EXACT_KVA)
    assert solution.converged.all()
    w = (solution.v_pu / shunted.voltage_ratio)[:, 1:] ** 2
    first = shunted.parent == 0
    lost_kvar = 1e3 * solution.current_sq_pu @ shunted.x_pu
    entering = solution.p_branch_kw[:, first].sum(axis=1), solution.q_branch_kvar[:, first].sum(axis=1)
    leaving_kw = p_kw[:, 1:].sum(axis=1) + w @ shunted.shunt_kw[1:] + solution.loss_kw
    leaving_kvar = q_kvar[:, 1:].sum(axis=1) - w @ shunted.shunt_kvar[1:] + lost_kvar
    np.testing.assert_allclose(entering, (leaving_kw, leaving_kvar), atol=1e-6, rtol=0.0)
    assert np.abs(w @ shunted.shunt_kw[1:]).min() > 1.0  # there is something to be wrong about


def test_a_row_alone_in_a_block_and_as_arrays_is_one(shunted, random_loads):
    p_kw, q_kvar, v0_pu = random_loads(shunted, 40, seed=61)
    batch = distflow(shunted, p_kw, q_kvar, v0_pu, tolerance_kva=EXACT_KVA)
    for row in (0, 11, 39):
        alone = distflow(shunted, p_kw[row], q_kvar[row], v0_pu[row], tolerance_kva=EXACT_KVA)
        for name in batch._fields:
            np.testing.assert_array_equal(getattr(alone, name), getattr(batch, name)[row])
    arrays = distflow_arrays(
        shunted, *map(torch.tensor, (p_kw, q_kvar, v0_pu)), warm=None, tolerance=1e-3 * EXACT_KVA, max_sweeps=1000
    )
    np.testing.assert_allclose(arrays.v_pu, batch.v_pu, atol=1e-12, rtol=0.0)
    np.testing.assert_allclose(arrays.p_branch_kw, batch.p_branch_kw, atol=1e-6, rtol=0.0)
    warm = distflow(shunted, p_kw, q_kvar, v0_pu, warm=batch)
    np.testing.assert_allclose(warm.v_pu, batch.v_pu, atol=3e-8, rtol=0.0)
    single = distflow(shunted, *(a.astype(np.float32) for a in (p_kw, q_kvar, v0_pu)))
    assert single.converged.all()
    np.testing.assert_allclose(single.v_pu, batch.v_pu, atol=1e-5, rtol=0.0)


def test_a_residual_that_leaves_out_the_shunts_would_stop_too_early():
    # Without a current the first sweep changes shunts alone: they must hold it up.
    feeder = two_buses(0.0, 0.5, 0.0, 0.5, 1.0)
    solution = distflow(feeder, [0.0, 0.0], [0.0, 0.0], 1.0)
    assert solution.iterations > 3
    assert float(solution.v_pu[1]) == pytest.approx(1.0 / 0.75, abs=1e-6)


def test_the_derivative_is_that_of_finite_differences(shunted, random_loads):
    rng = np.random.default_rng(62)
    p_kw, q_kvar, v0_pu = random_loads(shunted, 3, seed=63)
    inputs = [torch.tensor(a, requires_grad=True) for a in (p_kw, q_kvar, v0_pu)]
    weights = [rng.normal(size=(3, n)) for n in (shunted.n_bus, *[shunted.n_branch] * 3)]

    def total(solution, sums):
        figures = (solution.v_pu, 1e-3 * solution.p_branch_kw, 1e-3 * solution.q_branch_kvar, solution.current_sq_pu)
        return sum(sums(w, figure) for w, figure in zip(weights, figures, strict=True)) + solution.loss_kw / 1e3

    recorded = total(
        distflow_tensors(shunted, *inputs, warm=None, tolerance=1e-13, max_sweeps=1000),
        lambda w, a: (torch.tensor(w) * a).sum(dim=-1),
    )
    slopes = torch.autograd.grad(recorded.sum(), inputs)
    for k, (slope, step) in enumerate(zip(slopes, (1.0, 1.0, 1e-4), strict=True)):
        direction = rng.normal(size=slope.shape)
        moved = [
            [a + (sign * step * direction if i == k else 0.0) for i, a in enumerate((p_kw, q_kvar, v0_pu))]
            for sign in (1.0, -1.0)
        ]
        up, down = (
            total(distflow(shunted, *loads, tolerance_kva=EXACT_KVA), lambda w, a: (w * a).sum(axis=-1))
            for loads in moved
        )
        found = (slope.numpy() * direction).reshape(3, -1)
        np.testing.assert_allclose(found.sum(axis=1), (up - down) / (2.0 * step), rtol=1e-5, atol=1e-7)


def test_the_compiled_derivative_is_that_of_the_recorded_sweeps(shunted, random_loads):
    loads = random_loads(shunted, 21, seed=64)
    found = []
    for solve in (distflow_tensors, distflow_arrays):
        inputs = [torch.tensor(a, requires_grad=True) for a in loads]
        solution = solve(shunted, *inputs, warm=None, tolerance=1e-13, max_sweeps=1000)
        (solution.v_pu.square().sum() + 1e-3 * solution.loss_kw.sum()).backward()
        found.append([one.grad for one in inputs])
    for one, other in zip(*found, strict=True):
        scale = other.abs().max()
        np.testing.assert_allclose(one / scale, other / scale, atol=1e-8, rtol=0.0)


def test_lindistflow_is_linear_in_loads_and_squared_voltages(shunted, random_loads):
    p_kw, q_kvar, v0_pu = random_loads(shunted, 12, seed=65)
    solution = lindistflow(shunted, p_kw, q_kvar, v0_pu)
    assert solution.converged.all()
    w = (solution.v_pu / shunted.voltage_ratio) ** 2
    p = (p_kw + w * shunted.shunt_kw) / 1e3
    q = (q_kvar - w * shunted.shunt_kvar) / 1e3
    r, x = ((shunted.path * z) @ shunted.path.T for z in (shunted.r_pu, shunted.x_pu))
    np.testing.assert_allclose(w, v0_pu[:, None] ** 2 - 2.0 * (p @ r.T + q @ x.T), atol=1e-8, rtol=0.0)
    arrays = lindistflow_arrays(shunted, *map(torch.tensor, (p_kw, q_kvar, v0_pu)))
    np.testing.assert_allclose(arrays.v_pu, solution.v_pu, atol=1e-9, rtol=0.0)
    assert not lindistflow(shunted, 1e3 * abs(p_kw), q_kvar, v0_pu).converged.any()


def test_sensitivities_are_of_the_reported_voltage(shunted):
    plain = dataclasses.replace(shunted, voltage_ratio=None)
    for of in (sensitivity, own_sensitivity):
        for with_ratio, without in zip(of(shunted), of(plain), strict=True):
            ratio = shunted.voltage_ratio if without.ndim == 1 else shunted.voltage_ratio[:, None]
            np.testing.assert_allclose(with_ratio, ratio * without, rtol=1e-13)


def test_a_shunt_of_nothing_and_a_ratio_of_one_change_nothing(toy6, random_loads):
    none, one = np.zeros(6), np.ones(6)
    same = dataclasses.replace(toy6, shunt_kw=none, shunt_kvar=none, voltage_ratio=one)
    for n_row in (1, 20):
        loads = random_loads(toy6, n_row, seed=66)
        for expected, found in zip(distflow(toy6, *loads), distflow(same, *loads), strict=True):
            np.testing.assert_array_equal(found, expected)


def _network():
    """20 kV line with charging, transformer off its nominal tap, 0.4 kV lines with charging, two fixed shunts.

    Returns the network in pandapower and its feeder here, whose figures are worked out anew from the ratings.
    """
    net = pandapower.create_empty_network(sn_mva=1.0, f_hz=50.0)
    kv = [20.0, 20.0, 0.4, 0.4, 0.4]
    for vn_kv in kv:
        pandapower.create_bus(net, vn_kv=vn_kv)
    pandapower.create_ext_grid(net, 0, vm_pu=1.02)
    lines = [(0, 1, 8.0, 0.3, 0.35, 250.0, 2.0), (2, 3, 0.2, 0.2, 0.08, 4000.0, 0.0), (3, 4, 0.1, 0.4, 0.08, 9e4, 3.0)]
    for i, j, length, r, x, c_nf, g_us in lines:
        pandapower.create_line_from_parameters(net, i, j, length, r, x, c_nf, 1.0, g_us_per_km=g_us)
    pandapower.create_transformer_from_parameters(
        net, 1, 2, sn_mva=0.63, vn_hv_kv=20.0, vn_lv_kv=0.41, vkr_percent=1.1, vk_percent=6.0, pfe_kw=2.5,
        i0_percent=1.5, tap_side="hv", tap_neutral=0, tap_pos=-2, tap_step_percent=2.5, tap_changer_type="Ratio",
    )  # fmt: skip
    pandapower.create_shunt(net, 3, q_mvar=-0.08, p_mw=0.004)
    pandapower.create_shunt(net, 1, q_mvar=0.15)
    loads = {1: (400.0, 90.0), 3: (150.0, 50.0), 4: (-80.0, 20.0)}
    for bus, (p_kw, q_kvar) in loads.items():
        pandapower.create_load(net, bus, p_mw=p_kw / 1e3, q_mvar=q_kvar / 1e3)
    turns = (20.0 * 0.95 / 0.41) / (20.0 / 0.4)
    ratio = np.array([1.0, 1.0, *[1.0 / turns] * 3])
    kw, kvar = np.zeros(5), np.zeros(5)
    ohm = {}
    for i, j, length, r, x, c_nf, g_us in lines:
        ohm[i, j] = complex(r, x) * length * (20.0 / kv[j]) ** 2 / ratio[j] ** 2
        for end in (i, j):  # kV^2 times S is MVA
            kw[end] += 0.5e3 * 1e-6 * g_us * length * kv[end] ** 2 * ratio[end] ** 2
            kvar[end] += 0.5e3 * 2.0 * np.pi * 50.0 * 1e-9 * c_nf * length * kv[end] ** 2 * ratio[end] ** 2
    z = complex(1.1, np.sqrt(6.0**2 - 1.1**2)) / 100.0 / 0.63 * (0.41 / 0.4) ** 2
    ohm[1, 2] = 400.0 * z / ratio[2] ** 2
    magnetising = np.sqrt((0.015 * 630.0) ** 2 - 2.5**2)
    for end in (1, 2):
        kw[end] += 0.5 * 2.5 * ratio[2] ** 2 * (0.4 / 0.41) ** 2
        kvar[end] -= 0.5 * magnetising * ratio[2] ** 2 * (0.4 / 0.41) ** 2
    kw[3] += 4.0 * ratio[3] ** 2
    kvar[3] += 80.0 * ratio[3] ** 2
    kvar[1] -= 150.0
    ends = [(0, 1), (1, 2), (2, 3), (3, 4)]
    feeder = Feeder.from_tables(
        name="charged", base_kv=20.0, substation=0, v0_pu=1.02, bus_ids=range(5),
        p_load_kw=[loads.get(b, (0.0, 0.0))[0] for b in range(5)],
        q_load_kvar=[loads.get(b, (0.0, 0.0))[1] for b in range(5)],
        from_bus=[i for i, _ in ends], to_bus=[j for _, j in ends],
        r_ohm=[ohm[e].real for e in ends], x_ohm=[ohm[e].imag for e in ends],
        shunt_kw=kw.tolist(), shunt_kvar=kvar.tolist(), voltage_ratio=ratio.tolist(), bus_base_kv=kv,
    )  # fmt: skip
    return net, feeder


def test_lines_with_charging_a_tap_and_fixed_shunts_are_those_of_pandapower():
    net, feeder = _network()
    pandapower.runpp(net, trafo_model="pi", tolerance_mva=1e-11, init="flat", numba=False)
    solution = distflow(feeder, feeder.p_load_kw, feeder.q_load_kvar, tolerance_kva=EXACT_KVA)
    assert solution.converged
    np.testing.assert_allclose(solution.v_pu, net.res_bus.vm_pu, atol=1e-8, rtol=0.0)
    assert feeder.shunt_kw is not None
    assert feeder.shunt_kvar is not None
    shunt_kw = feeder.shunt_kw[0] * 1.02**2
    assert solution.p_branch_kw[0] + shunt_kw == pytest.approx(1e3 * net.res_ext_grid.p_mw[0], abs=1e-4)
    shunt_kvar = feeder.shunt_kvar[0] * 1.02**2
    assert solution.q_branch_kvar[0] - shunt_kvar == pytest.approx(1e3 * net.res_ext_grid.q_mvar[0], abs=1e-4)
