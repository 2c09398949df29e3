"""Fields that declare their allowed values."""

from dataclasses import dataclass

import numpy as np
import pytest

from dcgrid_env.core.checked import FieldError, choice, count, finite, number, settle


@dataclass(frozen=True, kw_only=True)
class _Part:
    high: float = number(0.0, 10.0, default=5.0)
    share: float = number(0.0, "high", default=1.0)
    steps: int = count(1, 1000, default=3)
    mode: str = choice("fast", "slow", default="fast")
    flag: bool = choice(True, False, default=True)
    values: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        settle(self, values=lambda given: given)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"share": -0.1}, r"^_Part: share is -0.1; give a finite number in \[0, high = 5\]$"),
        ({"share": 5.1}, r"share is 5.1; give a finite number in \[0, high = 5\]"),
        ({"share": float("nan")}, "share is nan; give a finite number"),
        ({"share": 1e-320}, r"share is 1e-320; give a finite number in \[0, high = 5\], 0 or of at least 2.2e-308"),
        ({"share": True}, "share is True; give a finite number"),
        ({"high": "5"}, r"high is '5'; give a finite number in \[0, 10\]"),
        ({"steps": 0}, "steps is 0; give a whole number of at least 1 and at most 1,000"),
        ({"steps": 2.0}, "steps is 2.0; give a whole number"),
        ({"steps": True}, "steps is True; give a whole number"),
        ({"mode": "Fast"}, "mode is 'Fast'; choose one of fast, slow"),
        ({"flag": 1}, "flag is 1; choose one of True, False"),
    ],
)
def test_a_wrong_value_is_named_with_its_remedy(given, message):
    with pytest.raises(FieldError, match=message):
        _Part(**given)


def test_ends_of_ranges_will_do():
    assert _Part(high=10.0, share=10.0, steps=1000, mode="slow", flag=False).share == 10.0


def test_arrays_and_scalars_become_pythons_own():
    part = _Part(values=np.array([1.0, 2.0]), steps=np.int64(4), share=np.array(2.0))  # type: ignore[arg-type]
    assert part.values == (1.0, 2.0)
    assert all(type(value) is float for value in part.values)
    assert (type(part.steps), type(part.share)) == (int, float)


def test_an_error_can_be_told_under_another_name():
    error = FieldError("Part", "share", 2.0, "give less")
    assert error.said("devices[0].share") == "devices[0].share is 2.0; give less"
    assert FieldError("Part", "share", ..., "rises too far").said("x") == "x rises too far"


def test_finite_within_bounds():
    assert finite(1, 0.0, 1.0)
    assert not any(finite(value, 0.0, 1.0) for value in (1.1, float("inf"), None, True, "1"))
