"""The sweep in array operations: differentiable, on any device, for torch tensors without a compiled kernel.

It is the sweep of ``sweep_rows`` by the zones of ``zones``. Rows that are done, or that have no solution, keep their
last voltages, so they corrupt neither values nor derivatives.
"""

from __future__ import annotations

from functools import partial
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, namespace, requires_grad
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.coverage import Coverage
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.grid.covered_fields import THREE_PHASE
from dcgrid_env.grid.three_phase_matrices import PHASE_BASE_KVA, Branches
from dcgrid_env.powerflow.solution import V_SQ_CEILING, V_SQ_FLOOR, PowerFlowError
from dcgrid_env.powerflow.unbalanced.plan import Plan, plan_of
from dcgrid_env.powerflow.unbalanced.three_phase_solution import ThreePhaseSolution
from dcgrid_env.powerflow.unbalanced.zones import Zone, zones_of

COVERED = Coverage(
    THREE_PHASE,
    arrays={
        Plan: """
            first up kind a z_re z_im regulator shunt leg_order leg_start leg_ends leg_is_z leg_has_exponents leg_law
            capacitor_ends capacitor_row capacitor_b core_ends core_g core_b source has_voltage ampere
        """,
        Branches: "a b regulator shunt sending_shunt",
    },
)
"""Feeders that the array operations cover."""
_FLOAT32_PU = 1e-5  # what rounding leaves of a voltage in float32 is less
_ROUNDING = {8: 1e-28, 4: 1e-12}  # a squared change of voltage that is rounding alone, by bytes a figure


class _Forms(NamedTuple):
    """A feeder's constants as one kind of array."""

    zones: tuple[Zone, ...]
    order: Array  # where each node stands in the zones' nodes, one after the other
    sent_from: tuple[Array, ...]  # where each zone's senders stand there
    sent_to: tuple[Array, ...]  # 0/1: a zone's phases to the nodes that feed them
    resistance: Array  # of all branches but the source's, (node, node)
    tapped: Array  # 0/1: regulator to the nodes that it feeds
    untapped: Array  # 1 at the nodes that no regulator feeds
    shunt: Array  # (node, node), imaginary
    legs: Array  # incidence of the loads' legs, (leg, node)
    law: tuple[Array, ...]  # the columns of plan.LAW
    is_z: Array
    has_exponents: Array | None  # None if no leg has
    capacitors: Array  # incidence of the capacitors' legs
    banks: Array
    capacitor_b: Array
    cores: Array  # incidence of the cores' legs
    core_y: Array
    source: Array
    ampere: Array


def sweep_arrays(
    feeder: ThreePhaseFeeder, inputs: tuple[Any, ...], start: Array | None, tolerance_pu: float, max_sweeps: int
) -> ThreePhaseSolution:
    """Solve as ``solve_batch`` does, with array operations alone.

    While a derivative is recorded a start is set aside: the derivative converges sweep by sweep like the voltage, and a
    start near the answer would stop before it has.

    Raises
    ------
    PowerFlowError
        For a feeder that is not radial, or that the array operations do not cover.
    """
    if not feeder.is_radial:
        raise PowerFlowError(
            f"feeder {feeder.name!r}: only radial feeders are solved on this device or by this array library; give "
            "NumPy arrays or torch tensors of the CPU"
        )
    if start is None or requires_grad(*inputs):
        return _sweeps(feeder, inputs, None, tolerance_pu, max_sweeps)
    xp = namespace(inputs[0])
    warm = _sweeps(feeder, inputs, start, tolerance_pu, max_sweeps)
    if bool(xp.all(warm.converged)):
        return warm
    cold, keep = _sweeps(feeder, inputs, None, tolerance_pu, max_sweeps), warm.converged
    pairs = zip(warm, cold, strict=True)
    return ThreePhaseSolution(*(xp.where(keep if a.ndim == keep.ndim else keep[..., None], a, b) for a, b in pairs))


@cached_on_owner
def _forms(feeder: ThreePhaseFeeder, xp: ModuleType, dtype: object, device: object) -> _Forms:
    if unknown := COVERED.first_unknown(feeder):
        raise PowerFlowError(
            f"feeder {feeder.name!r}: {unknown} is not supported on this device or by this array library; give NumPy "
            "arrays or torch tensors of the CPU"
        )
    plan, n = plan_of(feeder), feeder.n_node
    complex_dtype = xp.complex64 if dtype == xp.float32 else xp.complex128
    real = partial(_converted, xp, dtype, device)
    cplx = partial(_converted, xp, complex_dtype, device)
    index = partial(_converted, xp, xp.int64, device)
    zones = tuple(
        Zone(
            index(z.nodes), index(z.senders), cplx(z.enter), cplx(z.z), cplx(z.through), cplx(z.a), cplx(z.b),
            None if z.regulator is None else index(z.regulator),
        )
        for z in zones_of(feeder)
    )  # fmt: skip
    shunt, resistance = np.zeros((n, n), np.complex128), np.zeros((n, n))
    tapped = np.zeros((feeder.n_regulator, n))
    for i in range(feeder.n_bus):
        nodes = slice(feeder.first_node[i], feeder.first_node[i + 1])
        size = nodes.stop - nodes.start
        shunt[nodes, nodes] = 1j * feeder.branches.shunt[i, :size, :size]
        resistance[nodes, nodes] = feeder.branches.b[i, :size, :size].real if i else 0.0
        for k, row in enumerate(feeder.branches.regulator[i, :size]):
            if row >= 0:
                tapped[row, nodes.start + k] = 1.0
    position = np.argsort(np.concatenate([z.nodes for z in zones_of(feeder)]))
    order, law = np.argsort(plan.leg_order.astype(int)), plan.leg_law
    return _Forms(
        zones=zones,
        order=index(position),
        sent_from=tuple(index(position[z.senders]) for z in zones_of(feeder)),
        sent_to=tuple(cplx(np.eye(n)[z.senders]) for z in zones_of(feeder)),
        resistance=cplx(resistance),
        tapped=real(tapped),
        untapped=real(1.0 - tapped.sum(0)),
        shunt=cplx(shunt),
        legs=cplx(_incidence(plan.leg_ends, n)[order]),
        law=tuple(real(column) for column in law[order].T),
        is_z=xp.asarray(plan.leg_is_z[order], device=device),
        has_exponents=xp.asarray(powers[order], device=device) if (powers := plan.leg_has_exponents).any() else None,
        capacitors=cplx(_incidence(plan.capacitor_ends, n)),
        banks=index(plan.capacitor_row),
        capacitor_b=cplx(1j * plan.capacitor_b),
        cores=cplx(_incidence(plan.core_ends, n)),
        core_y=cplx(plan.core_g + 1j * plan.core_b),
        source=cplx(plan.source[:, 0] + 1j * plan.source[:, 1]),
        ampere=real(plan.ampere),
    )


def _converted(xp: ModuleType, dtype: object, device: object, values: Array) -> Array:
    return xp.asarray(np.array(values), dtype=dtype, device=device)


def _incidence(ends: np.ndarray, n: int) -> np.ndarray:
    matrix = np.zeros((len(ends), n + 1))
    rows = np.arange(len(ends))
    matrix[rows, ends[:, 0].astype(int)] = 1.0
    matrix[rows, ends[:, 1].astype(int)] -= 1.0
    return matrix[:, :n]


def _square(v: Array) -> Array:
    return v.real * v.real + v.imag * v.imag


def _drawn(f: _Forms, inputs: tuple[Any, ...], v: Array) -> Array:
    """Return the draw of all connected elements at voltage v, p.u., by node."""
    p_kw, q_kvar, _, _, state = inputs
    xp, n_load = namespace(p_kw), f.legs.shape[0]
    scale, rated_sq, z_p, i_p, c_p, z_q, i_q, c_q, floor, low, very_low, a_p, b_p, a_q, b_q, n_p, n_q = f.law
    across = v @ f.legs.T
    u = xp.sqrt(rated_sq / xp.clip(_square(across), V_SQ_FLOOR * 1e-4, None))  # 1 / u
    c = xp.maximum(u, floor)
    h_p, h_q = z_p + c * (i_p + c * c_p), z_q + c * (i_q + c * c_q)
    if f.has_exponents is not None:
        inside = f.has_exponents & (u >= floor)
        h_p, h_q = (xp.where(inside, u**n, h) for n, h in ((n_p, h_p), (n_q, h_q)))
    h_p, h_q = xp.where(u > low, a_p + b_p * u, h_p), xp.where(u > low, a_q + b_q * u, h_q)
    is_z = (u > very_low) | f.is_z
    g_p, g_q = (xp.where(is_z, xp.ones_like(u), h) for h in (h_p, h_q))
    y = p_kw[..., :n_load] * scale * g_p - 1j * q_kvar[..., :n_load] * scale * g_q
    power = (p_kw[..., n_load:] - 1j * q_kvar[..., n_load:]) / PHASE_BASE_KVA
    banks = (v @ f.capacitors.T) * f.capacitor_b * state[..., f.banks]
    devices = power * v / xp.clip(_square(v), V_SQ_FLOOR, None)
    cores = (v @ f.cores.T) * f.core_y
    return v @ f.shunt + (y * across) @ f.legs + devices + banks @ f.capacitors + cores @ f.cores


def _sweep(f: _Forms, inputs: tuple[Any, ...], ideal: Array, drawn: Array) -> tuple[Array, Array]:
    """Voltages, and currents of the branches to each node, that follow from what is drawn at each node."""
    xp, ratio, n_zone = namespace(inputs[0]), inputs[3], len(f.zones)
    within, entering = [drawn] * n_zone, [drawn] * n_zone
    for k in range(n_zone - 1, -1, -1):
        zone = f.zones[k]
        within[k] = drawn[..., zone.nodes]
        entering[k] = within[k] @ zone.enter.T
        if k:
            sent = entering[k] @ zone.a
            sent = sent if zone.regulator is None else sent * ratio[..., zone.regulator]
            drawn = drawn + sent @ f.sent_to[k]
    voltages: list[Array] = []
    for k, zone in enumerate(f.zones):
        drop = entering[k] @ zone.b.T
        if k:
            head = xp.concat(voltages, axis=-1)[..., f.sent_from[k]] @ zone.a.T
            r = 1.0 if zone.regulator is None else ratio[..., zone.regulator]
            head = r * (head - r * drop)
        else:
            head = ideal - drop
        voltages.append(head @ zone.enter - within[k] @ zone.z.T)
    currents = [within[k] @ zone.through for k, zone in enumerate(f.zones)]
    return xp.concat(voltages, axis=-1)[..., f.order], xp.concat(currents, axis=-1)[..., f.order]


def _error_sq(xp: ModuleType, change: Array, before: Array, rounding: float) -> Array:
    """Estimate what is left of the error: see ``sweep_rows.error_sq``."""
    ratio = xp.clip(xp.sqrt(change / before), 0.1, None)
    left = change * (ratio / xp.where(ratio < 1.0, 1.0 - ratio, xp.ones_like(ratio))) ** 2
    return xp.where(change <= rounding, change, xp.where(ratio < 1.0, left, xp.inf))


def _sweeps(
    feeder: ThreePhaseFeeder, inputs: tuple[Any, ...], start: Array | None, tolerance_pu: float, max_sweeps: int
) -> ThreePhaseSolution:
    p_kw, _, source_pu, ratio, _ = inputs
    xp = namespace(p_kw)
    f = _forms(feeder, xp, p_kw.dtype, p_kw.device)
    tolerance = max(tolerance_pu, _FLOAT32_PU) if p_kw.dtype == xp.float32 else tolerance_pu
    rounding = _ROUNDING[4 if p_kw.dtype == xp.float32 else 8]
    n = feeder.n_node
    ideal = source_pu[..., None] * f.source
    nothing = xp.zeros((*source_pu.shape, n), dtype=f.source.dtype, device=p_kw.device)
    v, current = _sweep(f, inputs, ideal, nothing)
    if start is not None:
        given_start = (xp.any(start != 0, axis=-1) & xp.all(xp.isfinite(start), axis=-1))[..., None]
        v = xp.where(given_start, start[..., :n] + 1j * start[..., n:], v)
    active = xp.ones_like(source_pu, dtype=xp.bool)
    good, iterations = ~active, xp.zeros_like(source_pu, dtype=xp.int64)
    before, left = xp.ones_like(source_pu), xp.full_like(source_pu, xp.inf)
    for _ in range(max_sweeps):
        new_v, new_current = _sweep(f, inputs, ideal, _drawn(f, inputs, v))
        v_sq = _square(new_v)
        alive = (xp.min(v_sq, axis=-1) > V_SQ_FLOOR) & (xp.max(v_sq, axis=-1) < V_SQ_CEILING)
        change = xp.max(_square(new_v - v), axis=-1)
        error = xp.where(alive, _error_sq(xp, change, before, rounding), xp.inf)
        on = (active & alive)[..., None]
        v, current = xp.where(on, new_v, v), xp.where(on, new_current, current)
        left = xp.where(active, error, left)
        iterations = iterations + xp.astype(active, xp.int64)
        good = good | (active & (error <= tolerance * tolerance))
        active = active & alive & (error > tolerance * tolerance)
        before = xp.where(change > 0, change, xp.ones_like(change))
        if not bool(xp.any(active)):
            break
    return _solution(f, v, current, ratio, good, iterations, xp.sqrt(left) * PHASE_BASE_KVA)


def _solution(
    f: _Forms, v: Array, current: Array, ratio: Array, good: Array, iterations: Array, residual: Array
) -> ThreePhaseSolution:
    xp = namespace(v)
    at_neutral = current * (ratio @ f.tapped + f.untapped)  # B of a regulator goes with the squared ratio
    lost = (xp.conj(at_neutral) * (at_neutral @ f.resistance)).real
    in_cores = _square(v @ f.cores.T) * f.core_y.real
    power = xp.sum(v[..., :3] * xp.conj(current[..., :3]), axis=-1) * PHASE_BASE_KVA
    volts = xp.concat((v.real, v.imag), axis=-1)
    return ThreePhaseSolution(
        v_pu=xp.sqrt(_square(v)),
        v_re_pu=v.real,
        v_im_pu=v.imag,
        i_re_a=current.real * f.ampere,
        i_im_a=current.imag * f.ampere,
        loss_kw=(xp.sum(lost, axis=-1) + xp.sum(in_cores, axis=-1)) * PHASE_BASE_KVA,
        source_p_kw=power.real,
        source_q_kvar=power.imag,
        converged=good,
        iterations=iterations,
        residual_kva=residual,
        restart=volts.detach() if hasattr(volts, "detach") else volts,
    )
