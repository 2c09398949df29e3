"""The functions of ``core.formula`` as kernels of numbers. A value that is not finite remains so."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled


@compiled(inner=True)
def least(a, b):
    """See ``formula.least``."""
    return b if b < a else a


@compiled(inner=True)
def most(a, b):
    """See ``formula.most``."""
    return b if b > a else a


@compiled(inner=True)
def positive(a):
    """See ``formula.positive``."""
    return 0.0 if a < 0.0 else a


@compiled(inner=True)
def root(a):
    """See ``formula.root``."""
    return np.sqrt(0.0 if a < 0.0 else a)


@compiled(inner=True)
def choose(condition, a, b):
    """See ``formula.choose``."""
    return a if condition else b
