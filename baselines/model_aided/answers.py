"""What an agent's reactive power does to the voltages once the others have answered it.

Each agent j responds to what it sees, E_j, by b_j kvar per p.u. on average. Where i injects a kvar more, the others see
it and answer, and answer each other's answers:

    h_j = b_j (X_ij + sum_l h_l X_lj)  over j, l other than i          X'_ik = X_ik + sum_j h_j X_jk

with X_ij the rise at j's bus. Agents that take the slope of the cost along X assume that the others do not respond.
They keep each other at opposite limits, since each one's effect on the voltages is undone by the other.
"""

from __future__ import annotations

import numpy as np

_LEAST_VARIANCE = 1e-14


def slopes(own_e_pu: np.ndarray, kvar: np.ndarray) -> np.ndarray:
    """How each agent responds to what it sees, b, kvar per p.u., at most 0, (n,).

    Regressed over moments: ``own_e_pu``, (m, n), is its voltage without its own part, ``kvar``, (m, n), its response.
    """
    e, q = own_e_pu - own_e_pu.mean(axis=0), kvar - kvar.mean(axis=0)
    return np.minimum((e * q).mean(axis=0) / np.maximum((e * e).mean(axis=0), _LEAST_VARIANCE), 0.0)


def answered(by_q: np.ndarray, at_own: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """X', p.u. per kvar, (n, k).

    Parameters
    ----------
    by_q
        X, rise of each voltage by each agent's injection while the others stand still, p.u. per kvar, (n, k).
    at_own
        Rise at the bus of each agent (column) by each agent's injection (row), p.u. per kvar, (n, n).
    slope
        b, kvar per p.u., (n,).
    """
    n = len(by_q)
    others = at_own.T * (1.0 - np.eye(n))
    joint = np.linalg.inv(np.eye(n) - slope[:, None] * others)  # column i: all setpoints in proportion, where i moves
    return (joint / np.diag(joint)).T @ by_q
