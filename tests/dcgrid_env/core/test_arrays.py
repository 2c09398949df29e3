"""The array helpers give the same on NumPy arrays and torch tensors, and never write to what they are given."""

import numpy as np
import pytest
import torch

from dcgrid_env.core.arrays import add_at, as_like, namespace, positive_part, requires_grad, take_at

KINDS = {"numpy": np.asarray, "torch": torch.tensor}


@pytest.fixture(params=KINDS)
def array(request):
    return KINDS[request.param]


def test_namespace_gives_functions_that_keep_the_kind(array):
    values = array([1.0, 4.0])
    root = namespace(values).sqrt(values)
    assert type(root) is type(values)
    assert root.tolist() == [1.0, 2.0]


def test_namespace_refuses_what_is_no_array():
    with pytest.raises(TypeError):
        namespace([1.0, 2.0])


@pytest.mark.parametrize("values", [3, 2.5, [1, 2], np.array([1, 2]), np.array([0.1, 0.2], dtype=np.float64)])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_as_like_takes_kind_and_precision(array, values, precision):
    like = array([9.0], dtype=getattr(np if array is np.asarray else torch, precision))
    made = as_like(values, like)
    assert type(made) is type(like)
    assert made.dtype == like.dtype
    np.testing.assert_array_equal(np.asarray(made), np.asarray(values, dtype=precision))


def test_as_like_takes_read_only_memory_without_sharing_it_with_a_tensor():
    frozen = np.array([1.0, 2.0])
    frozen.flags.writeable = False
    tensor = as_like(frozen, torch.zeros(1, dtype=torch.float64))
    tensor += 1.0
    assert frozen.tolist() == [1.0, 2.0]


def test_as_like_keeps_the_derivative_of_a_tensor():
    source = torch.tensor([1.0, 2.0], dtype=torch.float32, requires_grad=True)
    before = torch.is_warn_always_enabled()
    torch.set_warn_always(True)  # torch warns once a process, which would make this test depend on the others
    try:
        as_like(source, torch.zeros(1, dtype=torch.float64)).sum().backward()
    finally:
        torch.set_warn_always(before)
    assert source.grad is not None
    assert source.grad.tolist() == [1.0, 1.0]


def test_positive_part(array):
    values = array([-2.0, -0.0, 0.0, 3.0])
    part = positive_part(values)
    assert type(part) is type(values)
    assert part.tolist() == [0.0, 0.0, 0.0, 3.0]
    assert values.tolist() == [-2.0, -0.0, 0.0, 3.0]


def test_add_at_and_take_at_worked_by_hand(array):
    base = array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    where = array([[2, 0], [3, 5]])
    added = add_at(base, where, array([[10.0, 20.0], [30.0, 40.0]]))
    assert type(added) is type(base)
    assert added.tolist() == [[21.0, 2.0, 13.0], [34.0, 5.0, 46.0]]
    assert base.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert take_at(added, where).tolist() == [[13.0, 21.0], [34.0, 46.0]]


def test_add_at_has_the_derivative_of_a_sum():
    base = torch.zeros((2, 2), dtype=torch.float64, requires_grad=True)
    values = torch.ones(2, dtype=torch.float64, requires_grad=True)
    weights = torch.tensor([[1.0, 2.0], [3.0, 4.0]], dtype=torch.float64)
    (add_at(base, torch.tensor([3, 1]), values) * weights).sum().backward()
    assert base.grad is not None
    assert values.grad is not None
    assert base.grad.tolist() == weights.tolist()
    assert values.grad.tolist() == [4.0, 2.0]


def test_requires_grad_looks_at_every_array():
    plain, recorded = torch.zeros(2), torch.zeros(2, requires_grad=True)
    assert not requires_grad(plain, np.zeros(2))
    assert requires_grad(plain, recorded)
    assert requires_grad(plain, recorded + 1.0)
    with torch.no_grad():
        assert not requires_grad(recorded + 1.0)
