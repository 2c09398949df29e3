"""One walker over values: what they hold decides, and nothing else."""

from dataclasses import dataclass

import numpy as np
import pytest

from dcgrid_env.core.digest import digest


@dataclass(frozen=True)
class _Pair:
    a: float
    b: tuple[float, ...] = ()


class _Slotted:
    __slots__ = ("a",)


def of(value):
    return digest([("", value)])


def test_values_that_differ_have_other_digests():
    values = [
        1.0, 2.0, True, None, "1", "", (1.0,), (1.0, 2.0), ((1.0,), 2.0), np.array([1.0]), np.array([[1.0]]),
        np.array([True]), _Pair(1.0), _Pair(1.0, (2.0,)), {"a": 1.0}, {"b": 1.0},
    ]  # fmt: skip
    assert len({of(value) for value in values}) == len(values)
    assert all(len(of(value)) == 16 and int(of(value), 16) >= 0 for value in values)


def test_equal_values_have_one_digest_whatever_their_type():
    assert of(1) == of(1.0) == of(np.float32(1.0)) == of(np.int64(1))
    assert of(np.array([1, 2], np.int32)) == of(np.array([1, 2], np.int64))
    assert of({"a": 1, "b": 2}) == of({"b": 2, "a": 1})
    assert of(np.arange(6.0).reshape(2, 3).T) == of(np.ascontiguousarray(np.arange(6.0).reshape(2, 3).T))


def test_names_and_fields_count():
    assert digest([("a", 1.0)]) != digest([("b", 1.0)])
    alone = digest(
        [("", _Pair(1.0, (5.0,)))], lambda value: ("P", [("a", value.a)]) if isinstance(value, _Pair) else None
    )
    assert alone == digest(
        [("", _Pair(1.0))], lambda value: ("P", [("a", value.a)]) if isinstance(value, _Pair) else None
    )


def test_what_cannot_be_read_is_named():
    with pytest.raises(ValueError, match="_Slotted has __slots__, so its fields cannot be hashed"):
        of(_Slotted())
