"""DistFlow of a weakly meshed feeder: its loops are opened and compensated.

Each loop is opened at the receiving end b of the branch that closes it, which then feeds a break point b'. The power S
through the break point is drawn at b' and injected at b. It is found such that both have the same complex voltage. A
branch i -> j turns and scales a voltage by

    V_j / V_i = 1 - z conj(S_ij) / |V_i|^2

so the two voltages follow from DistFlow's flows on the two ways from the bus where they meet. With Z the impedance
matrix of the loops, in which an entry is the impedance of the branches that two loops share, S changes after each sweep
by

    conj(dS) = Z^-1 (V_b' - V_b) conj(V_b)

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
    """Where the branches of each loop begin in ``branch``, those on the way to b' first, shape (n_loop + 1,)."""
    middle: NDArray[np.intp]
    """Where its branches on the way to b begin, shape (n_loop,)."""
    branch: NDArray[np.intp]
    """Place that each branch of a loop feeds."""
    meet: NDArray[np.intp]
    """Place where the two ways of each loop begin, shape (n_loop,)."""
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
    ways, meet = [], []
    incidence = np.zeros((feeder.n_loop, opened.n_bus))
    for m, both in enumerate(zip(end.tolist(), to.tolist(), strict=True)):
        up, other = (_way(index.parent, place) for place in both)
        shared = set(up) & set(other)
        ways += [[k for k in way if k not in shared] for way in (up, other)]
        meet.append(max(shared, default=0))
        incidence[m, ways[-2]], incidence[m, ways[-1]] = 1.0, -1.0
    begins = np.cumsum([0, *map(len, ways)], dtype=np.intp)
    z_pu = np.concatenate(([0.0], (opened.r_pu + 1j * opened.x_pu)[index.order[1:] - 1]))
    y: NDArray[np.complex128] = np.linalg.inv((incidence * z_pu) @ incidence.T).astype(np.complex128)
    return Loops(
        end,
        to,
        begins[::2].copy(),
        begins[1::2].copy(),
        np.array([k for way in ways for k in way], dtype=np.intp),
        np.array(meet, dtype=np.intp),
        y.real.copy(),
        y.imag.copy(),
    )


def _way(parent: NDArray[np.intp], place: int) -> list[int]:
    way = []
    while place:
        way.append(place)
        place = int(parent[place])
    return way


def at_opened(feeder: Feeder, values: Any) -> Any:
    """Loads of the opened feeder: those of the buses (row, bus), and zero at the break points."""
    return np.concatenate((values, np.zeros((len(values), feeder.n_loop))), axis=1)
