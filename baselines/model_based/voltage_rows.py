"""What deviations of voltages cost in the linear program of an episode, with as few rows and unknowns as do.

A voltage that is on one side of 1 p.u. for all d and q within their ranges costs in proportion to them. It needs no
unknown e for its magnitude. A voltage that is always within the band needs no unknown w for its excess. On a feeder
with many nodes about half of the rows remain. If the cost has a voltage profile, deviations are those from the target
of each node beyond the band around it, and excesses remain those around 1 p.u.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import sparse


class Linear(NamedTuple):
    """Quantities of every step as linear functions of d and q."""

    at_zero: np.ndarray
    """Their values where d and q are 0, (T, n)."""
    by_d: np.ndarray
    """Slopes by d, (T, n, n_dc)."""
    by_q: np.ndarray
    """Slopes by q, (T, n, n_agent)."""

    def rows(self, where: np.ndarray, sign: np.ndarray | float = 1.0) -> tuple[Any, Any]:
        """Parts for d and q of a program's rows, those of the mask ``where`` (T n,), each times its sign."""
        signs = sparse.diags_array(np.broadcast_to(sign, where.shape)[where], format="csr")
        by_d, by_q = (sparse.block_diag(list(slopes), format="csr")[where] for slopes in (self.by_d, self.by_q))
        return signs @ by_d, signs @ by_q

    def reach(self, d: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest values, (T, n), for d and q within ranges (T, n_dc, 2) and (T, n_agent, 2)."""
        slopes, ranges = np.concatenate((self.by_d, self.by_q), axis=2), np.concatenate((d, q), axis=1)[:, None]
        ends = slopes[..., None] * ranges
        return self.at_zero + ends.min(axis=-1).sum(axis=-1), self.at_zero + ends.max(axis=-1).sum(axis=-1)


class VoltageRows(NamedTuple):
    """Rows of the program, and what is to be priced without one."""

    limits: list[tuple[dict[str, Any], np.ndarray]]
    """Parts of rows by their unknowns d, q, e and w, and what each row is at most."""
    by_d: np.ndarray
    """Sum of the deviations of known sign by d, (T n_dc,)."""
    by_q: np.ndarray
    """Their sum by q, (T n_agent,)."""
    at_zero: float
    """Their sum where d and q are 0, p.u."""


def voltage_rows(
    v_pu: Linear,
    d: np.ndarray,
    q: np.ndarray,
    band_pu: float,
    target_pu: np.ndarray | None = None,
    uncharged_pu: float = 0.0,
) -> VoltageRows:
    """The rows for voltages.

    Parameters
    ----------
    v_pu
        The voltages, p.u.
    d, q
        Ranges of d and q, as ``Linear.reach`` takes them.
    band_pu
        Half the width of the band around 1 p.u., beyond which excesses are charged.
    target_pu
        What deviations are taken from, p.u., (n,); None for 1 p.u.
    uncharged_pu
        Half the width of the band around the targets in which no deviation is charged.
    """
    reach = [side.ravel() for side in v_pu.reach(d, q)]
    target = 1.0 if target_pu is None else np.tile(target_pu, len(v_pu.at_zero))
    low, high = (side - target for side in reach)
    apart = v_pu.at_zero.ravel() - target
    sign = (low >= uncharged_pu).astype(float) - (high <= -uncharged_pu)
    either = sign == 0.0
    one = sparse.csr_array(sparse.identity(apart.size))
    limits = []
    for side in (1.0, -1.0):
        by_d, by_q = v_pu.rows(either, side)
        limits.append(({"d": by_d, "q": by_q, "e": -one[either]}, uncharged_pu - side * apart[either]))
    if target_pu is None:
        may_leave = np.maximum(-low, high) > band_pu
        picked = either & may_leave
        limits.append(({"e": one[picked], "w": -one[picked]}, np.full(picked.sum(), band_pu)))
        limits.append(_beyond(v_pu, one, ~either & may_leave, sign, band_pu))
    else:
        above, below = reach[1] > 1.0 + band_pu, reach[0] < 1.0 - band_pu
        limits += [_beyond(v_pu, one, *picked, band_pu) for picked in ((above, 1.0), (below, -1.0))]
    signs = sign.reshape(v_pu.at_zero.shape)
    by_d, by_q = (np.einsum("tn,tnu->tu", signs, slopes).ravel() for slopes in (v_pu.by_d, v_pu.by_q))
    return VoltageRows(limits, by_d, by_q, float((sign * apart - np.abs(sign) * uncharged_pu).sum()))


def _beyond(
    v_pu: Linear, one: Any, picked: np.ndarray, sign: np.ndarray | float, band_pu: float
) -> tuple[dict[str, Any], np.ndarray]:
    """Rows of the excesses w of voltages beyond the band, of some voltages on the side that the sign is of."""
    by_d, by_q = v_pu.rows(picked, sign)
    apart = sign * (v_pu.at_zero.ravel() - 1.0)
    return {"d": by_d, "q": by_q, "w": -one[picked]}, (band_pu - apart)[picked]
