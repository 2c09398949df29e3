"""How much of the others' reactive power an agent takes to move as it moves, found at commissioning.

With too little of it all agents together overshoot, each step taking back a part of the last; with too much they creep,
each step going on where the last one led. All begin at the static optimum and respond a few times at some moments of
the operation. An agent whose steps follow each other with correlation rho gets the damping that would have made it 0,
as a step is about inverse to the damping.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_ADJUSTMENTS = 3
_STEPS = 3
_SHARE = 0.7
"""Share of the way that one adjustment goes."""
_MOST_AT_ONCE = (0.6, 1.6)
_RANGE = (0.3, 3.0)
"""Bounds, as a share of where the damping begins."""
_LEAST_STEP = 1e-3
"""Steps below this share of the limit say nothing."""


def settled(
    begin: np.ndarray, start: np.ndarray, respond: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> np.ndarray:
    """The damping of each agent, (n,).

    Parameters
    ----------
    begin
        Damping to begin with, (n,).
    start
        Setpoints that all begin at, as shares of their limits, moments by agents, (m, n).
    respond
        New setpoints under a damping, (n,), after setpoints, (m, n).
    """
    damping = begin
    for _ in range(_ADJUSTMENTS):
        iterates = [start]
        for _ in range(_STEPS):
            iterates.append(respond(damping, iterates[-1]))
        steps = np.diff(iterates, axis=0)
        follows = (steps[1:] * steps[:-1]).sum(axis=(0, 1))
        rho = follows / np.maximum((steps[:-1] ** 2).sum(axis=(0, 1)), _LEAST_STEP**2 * start.shape[0])
        damping = damping * np.clip(1.0 - _SHARE * rho, *_MOST_AT_ONCE)
        damping = np.clip(damping, _RANGE[0] * begin, _RANGE[1] * begin)
    return damping
