"""distflow: what goes in and comes out, precision, tolerance, warm starts, and loads without a solution."""

import numpy as np
import pytest
import torch

from dcgrid_env import Solution, distflow, lindistflow
from dcgrid_env.powerflow.balanced.distflow_kernels import distflow_rows

SHAPES = {
    "v_pu": 6, "p_branch_kw": 5, "q_branch_kvar": 5, "current_sq_pu": 5,
    "loss_kw": None, "converged": None, "iterations": None, "residual_kva": None, "restart": 5,
}  # fmt: skip
FLOATS = ["v_pu", "p_branch_kw", "q_branch_kvar", "current_sq_pu", "loss_kw", "residual_kva"]


# --- shapes and kinds -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("leading", [(), (1,), (3,), (20,), (2, 3), (4, 1, 5), (0,), (0, 3)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_leading_dimensions_and_precision_are_those_of_the_loads(toy6, leading, dtype):
    rng = np.random.default_rng(3)
    p_kw = (toy6.p_load_kw * rng.random((*leading, 6))).astype(dtype)
    q_kvar = (toy6.q_load_kvar * rng.random((*leading, 6))).astype(dtype)
    solution = distflow(toy6, p_kw, q_kvar)
    assert solution._fields == tuple(SHAPES)
    for field, last in SHAPES.items():
        assert getattr(solution, field).shape == (leading if last is None else (*leading, last)), field
    assert all(getattr(solution, field).dtype == dtype for field in FLOATS)
    assert solution.converged.dtype == np.bool_
    assert solution.iterations.dtype.kind == "i"
    assert np.all(solution.converged)


def test_each_row_is_solved_with_its_own_load_and_substation_voltage(toy6, random_loads):
    p_kw, q_kvar, v0_pu = (a.reshape(2, 3, *a.shape[1:]) for a in random_loads(toy6, 6, seed=4))
    batch = distflow(toy6, p_kw, q_kvar, v0_pu)
    np.testing.assert_array_equal(batch.v_pu[..., 0], v0_pu)
    for row in np.ndindex(2, 3):
        alone = distflow(toy6, p_kw[row], q_kvar[row], v0_pu[row])
        for field in Solution._fields:
            np.testing.assert_array_equal(getattr(batch, field)[row], getattr(alone, field))


def test_lists_integers_and_mixed_precision_are_solved_in_float64(toy6, base):
    p_kw, q_kvar = base
    reference = distflow(toy6, p_kw, q_kvar)
    whole = distflow(toy6, p_kw.astype(int), q_kvar.astype(np.int32))
    for solution in (distflow(toy6, p_kw.tolist(), tuple(q_kvar)), whole, distflow(toy6, p_kw, q_kvar.astype("f4"))):
        assert solution.v_pu.dtype == np.float64
        assert solution.v_pu.tobytes() == reference.v_pu.tobytes()


def test_substation_voltage_is_the_feeders_own_unless_given(toy6, base):
    assert distflow(toy6, *base).v_pu[0] == toy6.v0_pu == 1.0
    for v0_pu in (1.05, np.float64(1.05), np.float32(1.05), np.array(1.05)):
        solution = distflow(toy6, *base, v0_pu=v0_pu)
        assert solution.v_pu[0] == pytest.approx(float(v0_pu), abs=1e-15)
    assert distflow(toy6, *base, v0_pu=1).v_pu.tobytes() == distflow(toy6, *base, v0_pu=1.0).v_pu.tobytes()


def test_substation_voltage_broadcasts_against_the_leading_shape(toy6, base):
    p_kw, q_kvar = (np.tile(load, (2, 3, 1)) for load in base)
    assert distflow(toy6, p_kw, q_kvar, [1.0, 1.01, 1.02]).v_pu[..., 0].tolist() == [[1.0, 1.01, 1.02]] * 2
    assert distflow(toy6, p_kw, q_kvar, [[0.99], [1.03]]).v_pu[..., 0].tolist() == [[0.99] * 3, [1.03] * 3]


def test_the_feeders_own_load_and_capacitors_are_not_added(feeder):
    solution = distflow(feeder, np.zeros(feeder.n_bus), np.zeros(feeder.n_bus), 1.03)
    assert (solution.v_pu == np.sqrt(1.03 * 1.03)).all()
    assert solution.loss_kw == 0.0
    assert not solution.p_branch_kw.any()


def test_load_at_the_substation_moves_no_voltage(toy6, base):
    p_kw, q_kvar = base
    reference = distflow(toy6, p_kw, q_kvar)
    p_kw[0], q_kvar[0] = 1e4, -3e3
    solution = distflow(toy6, p_kw, q_kvar)
    assert all(getattr(solution, f).tobytes() == getattr(reference, f).tobytes() for f in Solution._fields)


# --- what is given is left alone ------------------------------------------------------------------------------------


def frozen(array):
    array = array.copy()
    array.flags.writeable = False
    return array


def far_apart(array):
    return np.repeat(array, 3, axis=-1)[..., ::3]


def reversed_memory(array):
    return array[..., ::-1].copy()[..., ::-1]


@pytest.mark.parametrize("layout", [frozen, far_apart, reversed_memory, np.asfortranarray, np.copy])
@pytest.mark.parametrize("n_row", [1, 20])
def test_any_memory_layout_is_read_and_never_written(toy6, random_loads, layout, n_row):
    given = random_loads(toy6, n_row, seed=5)
    reference = distflow(toy6, *given, warm=np.zeros((n_row, 5)))
    arrays = [layout(array) for array in (*given, reference.current_sq_pu)]
    before = [array.tobytes() for array in arrays]
    compiled_for = len(distflow_rows.signatures)
    solution = distflow(toy6, *arrays[:3], warm=arrays[3])
    assert [array.tobytes() for array in arrays] == before
    assert len(distflow_rows.signatures) == compiled_for  # nothing is compiled anew for it
    np.testing.assert_allclose(solution.v_pu, reference.v_pu, atol=1e-8, rtol=0.0)


def test_broadcast_loads_of_no_memory_of_their_own(toy6, base):
    p_kw, q_kvar = (np.broadcast_to(load, (20, 6)) for load in base)
    np.testing.assert_array_equal(distflow(toy6, p_kw, q_kvar).v_pu, np.tile(distflow(toy6, *base).v_pu, (20, 1)))


def test_loads_of_the_other_byte_order(toy6, base):
    swapped = [load.astype(load.dtype.newbyteorder()) for load in base]
    np.testing.assert_array_equal(distflow(toy6, *swapped).v_pu, distflow(toy6, *base).v_pu)


def test_solutions_do_not_share_memory_with_the_loads_or_each_other(toy6, base):
    first = distflow(toy6, *base)
    kept = first.v_pu.copy()
    distflow(toy6, 3.0 * base[0], base[1])
    np.testing.assert_array_equal(first.v_pu, kept)
    assert not any(np.shares_memory(getattr(first, field), load) for field in Solution._fields for load in base)


# --- precision and tolerance ----------------------------------------------------------------------------------------


def test_default_tolerance_keeps_voltages_within_1e_8(feeder, random_loads):
    loads = random_loads(feeder, 30, seed=6)
    fine = distflow(feeder, *loads, tolerance_kva=1e-9)
    usual = distflow(feeder, *loads)
    assert fine.converged.all()
    assert usual.converged.all()
    assert (usual.residual_kva <= 1e-4).all()
    assert (fine.residual_kva <= 1e-9).all()
    assert (usual.iterations < fine.iterations).all()
    np.testing.assert_allclose(usual.v_pu, fine.v_pu, atol=1e-8, rtol=0.0)


def test_float32_is_within_1e_5_of_float64(feeder, random_loads):
    loads = random_loads(feeder, 30, seed=7)
    single = distflow(feeder, *(a.astype(np.float32) for a in loads))
    double = distflow(feeder, *loads)
    assert single.v_pu.dtype == np.float32
    assert single.converged.all()
    assert (single.residual_kva <= np.float32(1e-2)).all()
    np.testing.assert_allclose(single.v_pu, double.v_pu, atol=1e-5, rtol=0.0)
    np.testing.assert_allclose(single.loss_kw, double.loss_kw, rtol=1e-3, atol=1e-2)


@pytest.mark.parametrize("n_row", [1, 20])
def test_one_sweep_is_enough_without_load(toy6, n_row):
    solution = distflow(toy6, np.zeros((n_row, 6)), np.zeros((n_row, 6)), max_sweeps=1)
    assert solution.converged.all()
    assert (solution.iterations == 1).all()


def test_a_tolerance_of_its_own_is_kept(toy6, base):
    loose, fine = (distflow(toy6, *base, tolerance_kva=t) for t in (1.0, 1e-9))
    assert loose.iterations < fine.iterations
    assert fine.residual_kva <= 1e-9 < loose.residual_kva <= 1.0


@pytest.mark.parametrize("n_row", [1, 20])
def test_too_few_sweeps_are_reported_as_not_converged(toy6, base, n_row):
    p_kw, q_kvar = (np.tile(load, (n_row, 1)) for load in base)
    full = distflow(toy6, p_kw, q_kvar)
    short = distflow(toy6, p_kw, q_kvar, max_sweeps=int(full.iterations[0]) - 1)
    assert not short.converged.any()
    assert (short.residual_kva > 1e-4).all()
    assert np.isfinite(short.v_pu).all()
    enough = distflow(toy6, p_kw, q_kvar, max_sweeps=int(full.iterations[0]))
    assert enough.converged.all()
    assert enough.v_pu.tobytes() == full.v_pu.tobytes()


# --- warm starts ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n_row", [1, 40])
def test_a_warm_start_gives_the_same_answer_in_fewer_sweeps(feeder, random_loads, n_row):
    p_kw, q_kvar, v0_pu = random_loads(feeder, n_row, seed=8)
    before = distflow(feeder, 0.999 * p_kw, 0.999 * q_kvar, v0_pu)
    cold = distflow(feeder, p_kw, q_kvar, v0_pu)
    for start in (before, before.restart):
        warm = distflow(feeder, p_kw, q_kvar, v0_pu, warm=start)
        assert warm.converged.all()
        assert (warm.iterations < cold.iterations).all()
        np.testing.assert_allclose(warm.v_pu, cold.v_pu, atol=1e-7, rtol=0.0)
        np.testing.assert_allclose(warm.loss_kw, cold.loss_kw, atol=1e-3, rtol=0.0)


def test_a_warm_start_from_the_answer_takes_one_or_two_sweeps(feeder, random_loads):
    loads = random_loads(feeder, 40, seed=9)
    cold = distflow(feeder, *loads)
    again = distflow(feeder, *loads, warm=cold)
    assert again.iterations.max() <= 2
    assert (again.residual_kva <= 1e-4).all()
    np.testing.assert_allclose(again.v_pu, cold.v_pu, atol=1e-8, rtol=0.0)


@pytest.mark.parametrize("n_row", [1, 40])
def test_a_warm_start_from_a_very_different_load_still_converges(feeder, n_row):
    far = {"toy6": 13.0, "ieee33": 3.3, "das69": 3.0, "ieee123": 2.4, "khodr141": 4.0}[feeder.name]
    p_kw, q_kvar = (np.tile(load, (n_row, 1)) for load in (feeder.p_load_kw, feeder.q_load_kvar))
    light, heavy = distflow(feeder, 0.1 * p_kw, 0.1 * q_kvar), distflow(feeder, far * p_kw, far * q_kvar)
    assert heavy.converged.all()
    nonsense = np.full_like(light.restart, 1e6)
    unknown = np.full_like(light.restart, np.nan)
    for scale, start in ((0.1, heavy), (far, light), (-1.0, heavy), (1.0, nonsense), (1.0, unknown)):
        cold = distflow(feeder, scale * p_kw, scale * q_kvar)
        warm = distflow(feeder, scale * p_kw, scale * q_kvar, warm=start)
        assert cold.converged.all()
        assert warm.converged.all()
        np.testing.assert_allclose(warm.v_pu, cold.v_pu, atol=1e-6, rtol=0.0)


def test_a_warm_start_from_a_load_without_a_solution_still_converges(feeder):
    p_kw, q_kvar = (np.tile(load, (20, 1)) for load in (feeder.p_load_kw, feeder.q_load_kvar))
    lost = distflow(feeder, 20.0 * p_kw, 20.0 * q_kvar)
    assert not lost.converged.any()
    solution = distflow(feeder, p_kw, q_kvar, warm=lost)
    assert solution.converged.all()
    np.testing.assert_allclose(solution.v_pu, distflow(feeder, p_kw, q_kvar).v_pu, atol=1e-7, rtol=0.0)


def test_a_float64_start_serves_float32_loads(toy6, base):
    start = distflow(toy6, *base)
    solution = distflow(toy6, *(load.astype(np.float32) for load in base), warm=start)
    assert solution.converged
    assert solution.v_pu.dtype == np.float32


# --- loads without a solution ---------------------------------------------------------------------------------------


def hopeless(feeder):
    """A load factor that the feeder cannot carry: 6 on all but toy6, whose largest lies between 14 and 14.5."""
    return 40.0 if feeder.name == "toy6" else 6.0


@pytest.mark.parametrize("n_row", [5, 33, 200])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_row_without_a_solution_leaves_its_neighbours_their_bits(feeder, random_loads, n_row, dtype):
    p_kw, q_kvar, v0_pu = (a.astype(dtype) for a in random_loads(feeder, n_row, seed=10))
    good = distflow(feeder, p_kw, q_kvar, v0_pu)
    assert good.converged.all()
    for bad in (0, 3, n_row - 1):
        worse = p_kw.copy()
        worse[bad] = hopeless(feeder) * feeder.p_load_kw
        solution = distflow(feeder, worse, q_kvar, v0_pu)
        assert not solution.converged[bad]
        others = np.arange(n_row) != bad
        for field in Solution._fields:
            assert getattr(solution, field)[others].tobytes() == getattr(good, field)[others].tobytes(), field


@pytest.mark.parametrize("together", [False, True])
def test_figures_without_a_solution_are_finite(feeder, together):
    scale = hopeless(feeder) * np.concatenate([np.logspace(0, 6, 200), -np.logspace(3, 8, 200)])[:, None]
    p_kw, q_kvar = scale * feeder.p_load_kw, scale * feeder.q_load_kvar
    rows = [slice(None)] if together else range(len(scale))
    for row in rows:
        solution = distflow(feeder, p_kw[row], q_kvar[row])
        assert not np.any(solution.converged)
        for field in ("v_pu", "p_branch_kw", "q_branch_kvar", "current_sq_pu", "loss_kw"):
            assert np.isfinite(getattr(solution, field)).all(), field


def test_the_largest_load_of_two_buses_is_where_the_hand_worked_one_is(two_bus):
    # Load along one direction: a solution up to v0^2 / (2 (r p + x q + |z||s|)), from the quadratic in v_2^2.
    rng = np.random.default_rng(11)
    for _ in range(20):
        r, x = rng.uniform(0.01, 0.2, 2)
        p, q, v0_pu = rng.random(), rng.uniform(-0.1, 1.0), rng.uniform(0.9, 1.1)
        largest_kva = 1000.0 * v0_pu**2 / (2.0 * (r * p + x * q + np.hypot(r, x) * np.hypot(p, q)))
        load = largest_kva * np.array([[0.99], [1.01]])
        solution = distflow(two_bus(r, x), load * [0.0, p], load * [0.0, q], v0_pu)
        assert solution.converged.tolist() == [True, False]


@pytest.mark.parametrize("n_row", [1, 20])
@pytest.mark.parametrize("method", [distflow, lindistflow])
@pytest.mark.parametrize("kind", ["numpy", "arrays"])
@pytest.mark.parametrize(
    ("v0_pu", "settles"), [(0.01, False), (0.011, True), (99.0, True), (100.0, False), (101.0, False)]
)
def test_only_voltages_between_a_hundredth_and_a_hundred_are_operating_points(
    two_bus, by_arrays, kind, method, n_row, v0_pu, settles
):
    none = np.zeros((n_row, 2))
    if kind == "arrays":
        by_arrays()
        none = torch.zeros(n_row, 2, dtype=torch.float64)
    solution = method(two_bus(0.04, 0.07), none, none, v0_pu)
    assert solution.converged.tolist() == [settles] * n_row


@pytest.mark.parametrize("n_row", [1, 20])
@pytest.mark.parametrize("method", [distflow, lindistflow])
def test_a_collapsed_feeder_has_no_flow_and_next_to_no_voltage(feeder, method, n_row):
    p_kw, q_kvar = (1e3 * np.tile(load, (n_row, 1)) for load in (feeder.p_load_kw, feeder.q_load_kvar))
    solution = method(feeder, p_kw, q_kvar, 1.02)
    assert not solution.converged.any()
    assert np.isinf(solution.residual_kva).all()
    np.testing.assert_allclose(solution.v_pu[:, 0], 1.02)
    np.testing.assert_allclose(solution.v_pu[:, 1:], 0.01)
    for field in ("p_branch_kw", "q_branch_kvar", "current_sq_pu", "loss_kw"):
        assert not getattr(solution, field).any(), field
