"""A feeder's solution has the same bits alone, in any row of any batch, and on one thread or two."""

import numpy as np
import pytest

from dcgrid_env import Solution, distflow, lindistflow, load_feeder

N_ROW = 200


def mixed_loads(name, dtype):
    """200 rows: most ordinary, some close to collapse (more than 30 sweeps, a separate path), some beyond it."""
    feeder = load_feeder(name)
    rng = np.random.default_rng(40)
    p_kw = feeder.p_load_kw * rng.uniform(-0.5, 1.5, (N_ROW, feeder.n_bus))
    q_kvar = feeder.q_load_kvar * rng.uniform(-0.5, 1.5, (N_ROW, feeder.n_bus))
    most = {"toy6": 14.44, "ieee33": 3.618, "das69": 3.208, "ieee123": 2.523, "khodr141": 4.21}[name]  # within 0.2 %
    for first, scale in ((5, most), (11, 1.5 * most)):
        p_kw[first::17], q_kvar[first::17] = scale * feeder.p_load_kw, scale * feeder.q_load_kvar
        p_kw[first::17] *= rng.uniform(0.99, 1.0, (len(p_kw[first::17]), 1))
    return feeder, p_kw.astype(dtype), q_kvar.astype(dtype), rng.uniform(0.99, 1.02, N_ROW).astype(dtype)


def row(solution, i):
    return [getattr(solution, field)[i].tobytes() for field in Solution._fields]


def alone(solution):
    return [getattr(solution, field).tobytes() for field in Solution._fields]


def methods(feeder, v0_pu):
    """distflow from no current and from a start, and lindistflow, as functions of (p, q, rows of the batch)."""
    start = 0.05 * np.random.default_rng(41).random((N_ROW, feeder.n_bus - 1)).astype(v0_pu.dtype)
    return {
        "cold": lambda p, q, rows: distflow(feeder, p, q, v0_pu[rows]),
        "warm": lambda p, q, rows: distflow(feeder, p, q, v0_pu[rows], warm=start[rows]),
        "linear": lambda p, q, rows: lindistflow(feeder, p, q, v0_pu[rows]),
    }


@pytest.mark.parametrize("name", ["toy6", "ieee33", "das69", "ieee123", "khodr141"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("method", ["cold", "warm", "linear"])
def test_a_row_has_the_same_bits_in_every_batch(monkeypatch, name, dtype, method):
    feeder, p_kw, q_kvar, v0_pu = mixed_loads(name, dtype)
    solve = methods(feeder, v0_pu)[method]
    reference = [alone(solve(p_kw[i], q_kvar[i], i)) for i in range(N_ROW)]
    if method == "cold":  # the three kinds of row are there
        singles = [solve(p_kw[i], q_kvar[i], i) for i in range(N_ROW)]
        assert {bool(s.converged) for s in singles} == {True, False}
        assert any(s.converged and s.iterations > 30 for s in singles)
        assert any(s.converged and s.iterations < 15 for s in singles)
    everywhere = np.random.default_rng(42).permutation(N_ROW)
    batches = [np.arange(first, first + 5) for first in range(0, N_ROW, 5)]
    batches += [
        np.arange(33),
        np.arange(33)[::-1] + 100,
        everywhere[:33],
        np.arange(10),
        np.arange(11),
        everywhere[:128],
    ]
    batches += [np.arange(N_ROW), np.arange(N_ROW)[::-1], everywhere]
    for threads in ("1", "2"):
        monkeypatch.setenv("DCGRID_NUM_THREADS", threads)
        for rows in batches:
            solution = solve(p_kw[rows], q_kvar[rows], rows)
            for position, i in enumerate(rows):
                assert row(solution, position) == reference[i], (threads, len(rows), position)


def test_a_row_has_the_same_bits_in_a_batch_of_any_shape():
    feeder, p_kw, q_kvar, v0_pu = mixed_loads("ieee33", np.float64)
    flat = distflow(feeder, p_kw, q_kvar, v0_pu)
    shape = (4, 5, 10)
    shaped = distflow(feeder, *(a.reshape(*shape, *a.shape[1:]) for a in (p_kw, q_kvar, v0_pu)))
    assert alone(shaped) == alone(flat)


def test_solving_twice_gives_the_same_bits():
    feeder, *loads = mixed_loads("ieee123", np.float64)
    assert alone(distflow(feeder, *loads)) == alone(distflow(feeder, *loads))
