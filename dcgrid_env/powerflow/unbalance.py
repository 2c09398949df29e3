"""Voltage unbalance of a three-phase bus, by the two definitions in use.

The voltage unbalance factor is |V2| / |V1|, negative over positive sequence (C. L. Fortescue, "Method of symmetrical
co-ordinates applied to the solution of polyphase networks", Trans. AIEE 37, 1918; IEC 61000-4-30). NEMA MG 1 takes the
largest deviation of a line-to-line voltage from the mean of the three, over that mean.
"""

from __future__ import annotations

import math

import numpy as np

from dcgrid_env.core.arrays import Array, namespace, positive_sqrt, take_last
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.grid import ThreePhaseFeeder

TINY_PU = 1e-9
"""Added to what an unbalance is a share of, so that a bus without voltage has none."""


@cached_on_owner
def three_phase_nodes(feeder: ThreePhaseFeeder) -> np.ndarray:
    """Nodes of the phases a, b, c of each bus that has all three, but the source bus, (n_three_phase_bus, 3)."""
    return np.array(
        [feeder.nodes_at(bus) for bus in range(1, feeder.n_bus) if feeder.bus_phases[bus] == "abc"], dtype=np.int64
    ).reshape(-1, 3)


def unbalance_factor(nodes: np.ndarray, v_re_pu: Array, v_im_pu: Array) -> Array:
    """Voltage unbalance factor |V2| / |V1| of each bus with ``nodes`` (n_bus, 3), see ``three_phase_nodes``.

    ``v_re_pu`` and ``v_im_pu`` are the voltages of all nodes, real and imaginary part, p.u., (..., n_node).
    """
    (a_re, a_im), (b_re, b_im), (c_re, c_im) = _phasors(nodes, v_re_pu, v_im_pu)
    h = math.sqrt(0.75)
    sum_re, sum_im = a_re - 0.5 * (b_re + c_re), a_im - 0.5 * (b_im + c_im)
    turn_re, turn_im = h * (b_re - c_re), h * (b_im - c_im)
    positive = positive_sqrt((sum_re - turn_im) ** 2 + (sum_im + turn_re) ** 2)
    negative = positive_sqrt((sum_re + turn_im) ** 2 + (sum_im - turn_re) ** 2)
    return negative / (positive + TINY_PU)


def nema_unbalance(nodes: np.ndarray, v_re_pu: Array, v_im_pu: Array) -> Array:
    """Unbalance by NEMA MG 1 of each bus, a share, (..., n_bus); arguments as for ``unbalance_factor``."""
    xp, (a, b, c) = namespace(v_re_pu), _phasors(nodes, v_re_pu, v_im_pu)
    lines = [xp.hypot(p[0] - q[0], p[1] - q[1]) for p, q in ((a, b), (b, c), (c, a))]
    mean = (lines[0] + lines[1] + lines[2]) / 3.0
    off = [xp.abs(line - mean) for line in lines]
    return xp.maximum(xp.maximum(off[0], off[1]), off[2]) / (mean + TINY_PU)


def _phasors(nodes: np.ndarray, v_re_pu: Array, v_im_pu: Array) -> list[tuple[Array, Array]]:
    """Real and imaginary part of each phase's voltage at the three-phase buses."""
    xp = namespace(v_re_pu)
    if not isinstance(v_re_pu, np.ndarray):
        nodes = xp.asarray(nodes.copy(), device=v_re_pu.device)
    return [(take_last(v_re_pu, nodes[:, phase]), take_last(v_im_pu, nodes[:, phase])) for phase in range(3)]
