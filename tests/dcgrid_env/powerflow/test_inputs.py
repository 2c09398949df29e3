"""Input that no power flow can use: PowerFlowError, naming what is wrong, from both methods and both kinds of array."""

import numpy as np
import pytest
import torch

from dcgrid_env import PowerFlowError, distflow, lindistflow

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
@pytest.mark.parametrize("lanes", [1, 20])
@pytest.mark.parametrize("value", [NAN, INF])
@pytest.mark.parametrize("field", ["p_kw", "q_kvar"])
def test_a_load_at_the_substation_is_checked_as_well(toy6, method, kind, lanes, value, field):
    loads = {name: np.ones((lanes, 6)) for name in ("p_kw", "q_kvar")}
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


@pytest.mark.parametrize("options", [
    {"max_sweeps": 0}, {"max_sweeps": -3}, {"tolerance_kva": 0.0}, {"tolerance_kva": -1.0}, {"tolerance_kva": NAN},
])  # fmt: skip
@pytest.mark.parametrize("lanes", [1, 20])
def test_sweeps_and_tolerance_must_be_positive(toy6, kind, options, lanes):
    load = kind(np.ones((lanes, 6)))
    with pytest.raises(PowerFlowError, match=r"max_sweeps is .* and tolerance_kva .*; both must be positive"):
        distflow(toy6, load, load, **options)


def test_unusable_input_is_a_value_error_too(toy6):
    with pytest.raises(ValueError, match="p_kw has shape"):
        distflow(toy6, np.ones(3), np.ones(3))
