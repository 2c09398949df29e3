"""Input that no power flow can use: PowerFlowError, naming what is wrong, from both methods and both kinds of array."""

import numpy as np
import pandas as pd
import pytest
import torch

from dcgrid_env import Feeder, PowerFlowError, distflow, lindistflow
from dcgrid_env.powerflow.balanced.distflow_kernels import distflow_rows

BOTH = pytest.mark.parametrize("method", [distflow, lindistflow])
NAN, INF = float("nan"), float("inf")


@pytest.fixture(params=["numpy", "torch", "arrays"])
def kind(request, by_arrays):
    if request.param == "arrays":
        by_arrays()
    return np.asarray if request.param == "numpy" else lambda a, **k: torch.tensor(np.asarray(a), **k)


@BOTH
@pytest.mark.parametrize(("p_shape", "q_shape"), [
    ((5,), (5,)), ((7,), (7,)), ((6,), (5,)), ((2, 6), (6,)), ((6, 2), (6, 2)), ((), ()), ((1,), (1,)), ((0,), (0,)),
])  # fmt: skip
def test_wrong_shapes_name_feeder_and_shapes(toy6, method, kind, p_shape, q_shape):
    with pytest.raises(PowerFlowError, match=r"'toy6': p_kw has shape \(.*and q_kvar.*both must be \(\.\.\., 6\)"):
        method(toy6, kind(np.zeros(p_shape)), kind(np.zeros(q_shape)))


@BOTH
@pytest.mark.parametrize("value", [NAN, INF, -INF])
@pytest.mark.parametrize("field", ["p_kw", "q_kvar"])
@pytest.mark.parametrize("leading", [(), (4,), (20,), (2, 3)])
def test_loads_that_are_not_finite_name_field_bus_and_scenario(toy6, method, kind, value, field, leading):
    loads = {name: np.ones((*leading, 6)) for name in ("p_kw", "q_kvar")}
    at = tuple(n - 1 for n in leading)
    loads[field][(*at, 4)] = value
    scenario = f"({', '.join(map(str, at))}{',' if len(at) == 1 else ''})"
    with pytest.raises(PowerFlowError) as caught:
        method(toy6, kind(loads["p_kw"]), kind(loads["q_kvar"]))
    assert f"'toy6': {field} of bus 4 is {value} in scenario {scenario} of the batch" in str(caught.value)


@BOTH
def test_the_bus_is_named_by_its_own_name(method, kind):
    from dcgrid_env import load_feeder

    feeder = load_feeder("ieee123")
    p_kw = feeder.p_load_kw.copy()
    p_kw[feeder.index(450)] = NAN
    with pytest.raises(PowerFlowError, match="p_kw of bus 450 is nan"):
        method(feeder, kind(p_kw), kind(feeder.q_load_kvar))


@BOTH
@pytest.mark.parametrize("n_row", [1, 20])
@pytest.mark.parametrize("value", [NAN, INF])
@pytest.mark.parametrize("field", ["p_kw", "q_kvar"])
def test_a_load_at_the_substation_is_checked_as_well(toy6, method, kind, n_row, value, field):
    loads = {name: np.ones((n_row, 6)) for name in ("p_kw", "q_kvar")}
    loads[field][0, 0] = value
    with pytest.raises(PowerFlowError, match=f"{field} of bus 0 is {value}"):
        method(toy6, kind(loads["p_kw"]), kind(loads["q_kvar"]))


@pytest.mark.usefixtures("torch_warns_always")
def test_loads_that_are_not_finite_while_a_derivative_is_recorded(toy6):
    p_kw = torch.full((6,), NAN, requires_grad=True)
    with pytest.raises(PowerFlowError, match="is nan"):
        distflow(toy6, p_kw, torch.ones(6))


@BOTH
@pytest.mark.parametrize("v0_pu", [0.0, -1.0, NAN, INF, 0, [1.0, 0.0, 1.0], [1.0, NAN, 1.0], np.float64("nan")])
def test_substation_voltages_that_are_not_positive(toy6, method, kind, v0_pu):
    with pytest.raises(PowerFlowError, match=r"'toy6': v0_pu is .*give a positive substation voltage"):
        method(toy6, kind(np.ones((3, 6))), kind(np.ones((3, 6))), v0_pu)


@BOTH
@pytest.mark.parametrize(
    ("leading", "v0_shape"), [((), (1,)), ((3,), (2,)), ((3,), (3, 1)), ((2, 3), (2,)), ((3,), (6,))]
)
def test_substation_voltages_of_the_wrong_shape(toy6, method, kind, leading, v0_shape):
    load = kind(np.ones((*leading, 6)))
    with pytest.raises(PowerFlowError, match=r"v0_pu has shape \(.*for loads of shape \(.*6,?\)"):
        method(toy6, load, load, np.ones(v0_shape))


@BOTH
def test_loads_of_two_kinds(toy6, method):
    host, tensor = np.ones(6), torch.ones(6, dtype=torch.float64)
    for loads in ((host, tensor), (tensor, host), ([1.0] * 6, tensor), (tensor, [1.0] * 6)):
        with pytest.raises(PowerFlowError, match="give both as the same kind of array"):
            method(toy6, *loads)


@pytest.mark.parametrize("shape", [(6,), (4,), (1, 5), (3, 5), (0,)])
def test_a_warm_start_of_the_wrong_shape(toy6, kind, shape):
    with pytest.raises(PowerFlowError, match=r"warm start has shape \(.*must be \(5,\)"):
        distflow(toy6, kind(np.ones(6)), kind(np.ones(6)), warm=kind(np.ones(shape)))


def test_a_solution_of_another_batch_is_no_warm_start(toy6, kind):
    start = distflow(toy6, kind(np.ones((4, 6))), kind(np.ones((4, 6))))
    with pytest.raises(PowerFlowError, match=r"warm start has shape \(4, 5\);.* must be \(3, 5\)"):
        distflow(toy6, kind(np.ones((3, 6))), kind(np.ones((3, 6))), warm=start)


@pytest.mark.parametrize(("loads", "start"), [
    (np.ones(6), torch.ones(5, dtype=torch.float64)),
    (torch.ones(6, dtype=torch.float64), np.ones(5)),
    (np.ones(6), [1.0] * 5),
])  # fmt: skip
def test_a_warm_start_of_another_kind_is_taken(toy6, loads, start):
    plain = distflow(toy6, loads, loads)
    warm = distflow(toy6, loads, loads, warm=start)
    assert type(warm.v_pu) is type(plain.v_pu)
    np.testing.assert_allclose(np.asarray(warm.v_pu), np.asarray(plain.v_pu), atol=1e-7, rtol=0.0)


@pytest.mark.parametrize(("options", "given"), [
    ({"max_sweeps": 0}, "max_sweeps is 0"), ({"max_sweeps": -3}, "max_sweeps is -3"),
    ({"max_sweeps": 1.5}, r"max_sweeps is 1\.5"), ({"max_sweeps": 100.0}, r"max_sweeps is 100\.0"),
    ({"max_sweeps": True}, "max_sweeps is True"), ({"max_sweeps": "3"}, "max_sweeps is '3'"),
    ({"max_sweeps": None}, "max_sweeps is None"), ({"max_sweeps": NAN}, "max_sweeps is nan"),
    ({"max_sweeps": 10**30}, "max_sweeps is 10000"),
    ({"tolerance_kva": 0.0}, r"tolerance_kva is 0\.0"), ({"tolerance_kva": -1.0}, r"tolerance_kva is -1\.0"),
    ({"tolerance_kva": NAN}, "tolerance_kva is nan"), ({"tolerance_kva": INF}, "tolerance_kva is inf"),
    ({"tolerance_kva": True}, "tolerance_kva is True"), ({"tolerance_kva": "1"}, "tolerance_kva is '1'"),
    ({"tolerance_kva": 1j}, "tolerance_kva is 1j"), ({"tolerance_kva": [1.0]}, r"tolerance_kva is \[1\.0\]"),
])  # fmt: skip
@pytest.mark.parametrize("n_row", [1, 20])
def test_sweeps_are_counted_and_the_tolerance_is_a_positive_number(toy6, kind, options, given, n_row):
    load = kind(np.ones((n_row, 6)))
    with pytest.raises(PowerFlowError, match=f"{given}.*; give a (whole|positive) number"):
        distflow(toy6, load, load, **options)


def test_numbers_of_numpy_end_the_sweeps_as_pythons_do(toy6):
    load, compiled_for = np.ones(6), len(distflow_rows.signatures)
    plain = distflow(toy6, load, load, tolerance_kva=0.5, max_sweeps=7)
    other = distflow(toy6, load, load, tolerance_kva=np.float32(0.5), max_sweeps=np.int32(7))  # pyright: ignore
    assert all(getattr(plain, field).tobytes() == getattr(other, field).tobytes() for field in plain._fields)
    assert len(distflow_rows.signatures) == max(compiled_for, 1)  # nothing is compiled anew for it


# --- what holds no real numbers -------------------------------------------------------------------------------------

ONES = np.ones(6)
NO_FIGURES = [
    (ONES + 0j, "complex128"), (torch.ones(6, dtype=torch.complex64), "complex64"), ([1.0 + 0j] * 6, "complex128"),
    (ONES > 0, "bool"), (torch.ones(6) > 0, "bool"), (ONES.astype(object), "object"), (None, "object"),
    (["1"] * 6, "<U1"), ("load", "<U4"), (np.zeros(6, "m8[s]"), "timedelta64"), ({}, "object"),
    ([1.0, [2.0]], "no array"), (np.ma.masked_array(ONES, ONES > 0), "a masked array"),
    (torch.ones(6).to_sparse(), "a sparse tensor"), (pd.Series(ONES), "a Series"),
]  # fmt: skip


@BOTH
@pytest.mark.parametrize("field", ["p_kw", "q_kvar"])
@pytest.mark.parametrize(("values", "why"), NO_FIGURES)
def test_loads_that_are_no_real_numbers(toy6, method, field, values, why):
    other = torch.ones(6) if isinstance(values, torch.Tensor) else ONES
    loads = {"p_kw": other, "q_kvar": other} | {field: values}
    with pytest.raises(PowerFlowError, match=rf"'toy6': {field} is .*{why}.*(give|fill)"):
        method(toy6, **loads)


@BOTH
@pytest.mark.parametrize("value", [
    "1.0", ["1.0"], True, 1.0 + 0j, [None], {}, np.ma.masked_array([1.0], [True]), np.array(1.0, object),
])  # fmt: skip
def test_substation_voltages_that_are_no_real_numbers(toy6, method, kind, value):
    load = kind(np.ones((1, 6)))
    with pytest.raises(PowerFlowError, match=r"'toy6': v0_pu is .*; (give a positive substation voltage|fill it)"):
        method(toy6, load, load, value)


@pytest.mark.parametrize("value", [
    "x", ["1"] * 5, {}, np.ones(5) + 0j, np.ones(5) > 0, np.ones(5, object), np.ma.masked_array(np.ones(5), True),
])  # fmt: skip
def test_warm_starts_that_are_no_real_numbers(toy6, kind, value):
    with pytest.raises(PowerFlowError, match=r"'toy6': warm is .*; (give a Solution or its restart|fill it)"):
        distflow(toy6, kind(ONES), kind(ONES), warm=value)


@pytest.mark.parametrize("value", [NAN, INF, -1.0])
def test_a_warm_start_that_leads_nowhere_is_set_aside(toy6, kind, value):
    found = distflow(toy6, kind(ONES), kind(ONES), warm=np.full(5, value))
    assert bool(found.converged)
    np.testing.assert_allclose(np.asarray(found.v_pu), distflow(toy6, ONES, ONES).v_pu, atol=1e-7, rtol=0.0)


@pytest.mark.parametrize("name", ["v0_pu", "warm"])
def test_a_tensor_that_numpy_cannot_read(toy6, name):
    given = torch.ones(() if name == "v0_pu" else 5, dtype=torch.float64, requires_grad=True)
    with pytest.raises(PowerFlowError, match=rf"{name} is a Tensor that NumPy cannot read.*give {name}\.detach\(\)"):
        distflow(toy6, ONES, ONES, **{name: given})  # pyright: ignore[reportArgumentType]


@BOTH
def test_loads_on_two_devices(toy6, method):
    with pytest.raises(PowerFlowError, match="p_kw is on cpu and q_kvar on meta; give both on the same device"):
        method(toy6, torch.ones(6), torch.ones(6, device="meta"))


@BOTH
def test_loads_are_solved_in_float32_only_if_both_are(toy6, method, kind):
    single, double, whole = kind(ONES.astype("f4")), kind(ONES), kind(ONES.astype("i4"))
    assert "float32" in str(method(toy6, single, single).v_pu.dtype)
    for loads in ((single, double), (double, single), (single, whole), (whole, single)):
        assert "float64" in str(method(toy6, *loads).v_pu.dtype)


@BOTH
@pytest.mark.parametrize("feeder", [None, "ieee33", 5, {}, Feeder])
def test_what_is_no_feeder(method, kind, feeder):
    with pytest.raises(PowerFlowError, match=r"feeder is .*; give a Feeder, for instance load_feeder\('ieee33'\)"):
        method(feeder, kind(ONES), kind(ONES))


def test_unusable_input_is_a_value_error_too(toy6):
    with pytest.raises(ValueError, match="p_kw has shape"):
        distflow(toy6, np.ones(3), np.ones(3))
