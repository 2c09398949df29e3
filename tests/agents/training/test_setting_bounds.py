"""Every figure that an algorithm can be set to has bounds, and is refused by name beyond them."""

import dataclasses
import math
from typing import get_type_hints

import pytest

from dcgrid_env.agents.train_command import ALGORITHMS
from dcgrid_env.agents.training.config import ABOVE_0, WITHIN, check

KINDS = {name: algorithm.configuration() for name, algorithm in ALGORITHMS.items()}
FIGURES = [
    (name, field)
    for name, kind in KINDS.items()
    for field, hint in get_type_hints(kind).items()
    if hint in (int, float, int | None, float | None)
]


@pytest.mark.parametrize(("name", "field"), FIGURES)
def test_a_figure_beyond_its_bounds_is_refused_by_name(name, field):
    usual = KINDS[name]()
    check(usual)
    low, high = WITHIN[field] if field in WITHIN else (0.0, ABOVE_0[field])
    beyond = [high * 1.001 + 1.0, low - 1.0, math.nan, math.inf, -math.inf, *([0.0] if field in ABOVE_0 else [])]
    for value in beyond:
        with pytest.raises(ValueError, match=rf"^{field} is {value}; give "):
            check(dataclasses.replace(usual, **{field: value}))


@pytest.mark.parametrize("hidden", [(0,), (64, -1), (10**9,)])
def test_widths_that_cannot_be_are_refused(hidden):
    with pytest.raises(ValueError, match=r"^hidden is"):
        check(dataclasses.replace(KINDS["analytic"](), hidden=hidden))
