"""DistFlow of a weakly meshed feeder: its loops are opened and compensated.

Each loop is opened at the receiving end b of the branch that closes it, which then feeds a break point b' of its own.
The power S through the break point is drawn at b' and injected at b. It is found such that both have one voltage:

    |V_b'|^2 - |V_b|^2 = 0        arg V_b' - arg V_b = 0

The phase angle of a branch i -> j is that of v_i - conj(S_ij) z, so the angles follow from DistFlow's flows. With Z the
impedance matrix of the loops, in which an entry is the impedance of the branches that two loops share, S changes after
each sweep by

    conj(dS) = Z^-1 ((|V_b'|^2 - |V_b|^2) / 2 + j |V_b|^2 (arg V_b' - arg V_b))

D. Shirmohammadi, H. W. Hong, A. Semlyen, G. X. Luo, "A compensation-based power flow method for weakly meshed
distribution and transmission networks", IEEE Trans. Power Systems 3(2), 1988.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.grid.feeder import Feeder


class Loops(NamedTuple):
    """Constants of the loops for the kernels; a place is one in the depth-first order of the opened feeder."""

    end: NDArray[np.intp]
    """Place of each break point b', shape (n_loop,)."""
    to: NDArray[np.intp]
    """Place of its other side b, shape (n_loop,)."""
    first: NDArray[np.intp]
    """Where the branches of each loop begin in ``branch``, shape (n_loop + 1,)."""
    branch: NDArray[np.intp]
    """Place that each branch of a loop feeds."""
    sign: NDArray[np.float64]
    """1 for a branch on the way to b', -1 on the way to b."""
    y_re: NDArray[np.float64]
    """Real part of the inverse of the loops' impedance matrix, per unit, (n_loop, n_loop)."""
    y_im: NDArray[np.float64]
    """Imaginary part."""


@cached_on_owner
def loops_of(feeder: Feeder) -> Loops:
    """Loops of a feeder that is not radial."""
    opened, n = feeder.opened, feeder.n_bus
    index = opened.depth_first
    end, to = index.place[n:].copy(), index.place[feeder.to_bus[n - 1 :]]
    paths = []
    for both in zip(end.tolist(), to.tolist(), strict=True):
        ways = [_way(index.parent, place) for place in both]
        shared = set(ways[0]) & set(ways[1])
        signed = [(k, sign) for way, sign in zip(ways, (1.0, -1.0), strict=True) for k in way if k not in shared]
        paths.append(signed)
    first = np.cumsum([0, *map(len, paths)], dtype=np.intp)
    branch = np.array([k for path in paths for k, _ in path], dtype=np.intp)
    sign = np.array([sign for path in paths for _, sign in path])
    incidence = np.zeros((len(paths), opened.n_bus))
    for m, path in enumerate(paths):
        incidence[m, [k for k, _ in path]] = [sign for _, sign in path]
    z_pu = np.concatenate(([0.0], (opened.r_pu + 1j * opened.x_pu)[index.order[1:] - 1]))
    y: NDArray[np.complex128] = np.linalg.inv((incidence * z_pu) @ incidence.T).astype(np.complex128)
    return Loops(end, to, first, branch, sign, np.ascontiguousarray(y.real), np.ascontiguousarray(y.imag))


def _way(parent: NDArray[np.intp], place: int) -> list[int]:
    way = []
    while place:
        way.append(place)
        place = int(parent[place])
    return way


def at_opened(feeder: Feeder, values: Any) -> Any:
    """Loads (row, bus) with those of the break points, which draw nothing of their own."""
    return np.concatenate((values, np.zeros((len(values), feeder.n_loop))), axis=1)
