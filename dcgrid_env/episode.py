"""An episode as drawn: placement, trace windows, faults and noise, all functions of one key per lane."""

from __future__ import annotations

import zlib
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from dcgrid_env import counter, observation
from dcgrid_env.dynamics import Exogenous
from dcgrid_env.powerflow.threads import over_lanes
from dcgrid_env.scenario import Scenario
from dcgrid_env.traces import TraceRows, from_recordings, library, pv_rows, require_window

ROW_DURATION_S = 3600.0
"""Length of a generated trace; an episode takes a window of it."""
ROWS = 24
"""How many there are."""
FOR_GOOD = 2**40
"""Steps that outlast every episode."""


class Episode(NamedTuple):
    """What a reset draws, for a batch of lanes."""

    key: np.ndarray
    """(lane,) uint64."""
    buses: np.ndarray
    """Position in ``bus_ids`` of each agent's bus, (lane, n_agent)."""
    placed: observation.Placement
    start: np.ndarray
    """Where each data centre's trace window begins, flat position row * n_step + step of the pool, (lane, n_dc)."""
    sun: np.ndarray
    """The same of generated PV, (lane,); 0 where there is none."""
    fault: np.ndarray
    """What each fault strikes (see ``Scenario.fault_targets``), the first step without it and the first with it again,
    int64, (lane, n_fault, 3)."""


def window_steps(scenario: Scenario) -> int:
    """Steps of trace that an episode needs: t = 0, one an action, and the preview at the end."""
    return scenario.horizon + 2


@lru_cache(maxsize=1024)
def trace_pool(scenario: Scenario) -> TraceRows:
    """Rows that the scenario's split draws from: power, (n_row, n_step), and what is known of the work behind it."""
    trace, split, dt_s, steps = scenario.trace, scenario.split, float(scenario.dt_s), window_steps(scenario)
    needed_s = steps * dt_s
    if isinstance(trace, str):
        # Rounding may cost a step of dt at the end, so one more is asked for.
        duration_s = max(ROW_DURATION_S, needed_s + dt_s)
        # About a day in all, but a row for each site.
        count = min(ROWS, max(scenario.n_datacenters, round(ROWS * ROW_DURATION_S / duration_s), 1))
        rows, name = library(trace, split, dt_s, duration_s, count, scenario.boost_share), trace
    else:
        rows = from_recordings(trace, split, dt_s, needed_s, scenario.boost_share, scenario.recording_split)
        name = ", ".join(t.name for t in trace)
    require_window(rows, steps, dt_s, name)
    return rows


class _Load(NamedTuple):
    """What the load noise needs to know of a scenario, as the kernel takes it."""

    rho: float  # over one step
    sigma: float
    p_base_kw: np.ndarray
    q_base_kvar: np.ndarray
    q_fixed_kvar: np.ndarray


@lru_cache(maxsize=1024)
def _load(scenario: Scenario) -> _Load:
    feeder = scenario.feeder
    return _Load(
        rho=float(scenario.load_rho**scenario.dt_s),
        sigma=float(scenario.load_sigma),
        p_base_kw=feeder.p_load_kw.copy(),
        q_base_kvar=feeder.q_load_kvar.copy(),
        q_fixed_kvar=-feeder.capacitor_kvar if scenario.capacitors else np.zeros(feeder.n_bus),
    )


@lru_cache(maxsize=1024)
def sun_rows(scenario: Scenario) -> np.ndarray:
    """Active injection of the inverters as a share of their rating: a row for all episodes, or those of the PV drawn.

    (n_row, n_step), each row as long as an episode or longer.
    """
    trace, steps, dt_s = scenario.inverter_trace, scenario.horizon + 1, float(scenario.dt_s)
    if trace is None:
        return np.zeros((1, steps))
    if isinstance(trace, tuple):
        return np.array(trace[:steps])[None]
    if isinstance(trace, str):
        return pv_rows(scenario.split, dt_s, max(ROW_DURATION_S, steps * dt_s), ROWS)
    trace.require_duration(steps * dt_s)
    return trace.resample(dt_s)[None, :steps]


def check_traces(scenario: Scenario) -> None:
    """Raise TraceError unless every trace lasts as long as an episode."""
    trace_pool(scenario)
    sun_rows(scenario)


def draw(scenario: Scenario, seeds: np.ndarray, numbers: np.ndarray) -> Episode:
    """Draw an episode for each lane from its seed and the number of episodes since it was seeded, both (lane,) uint64.

    The split enters the key, so that no two splits share an episode whatever their seeds.
    """
    salt = np.uint64(zlib.crc32(scenario.split.encode()))
    key = counter.keys(salt, seeds, numbers)
    lanes, n_dc = len(key), scenario.n_datacenters
    fixed = [scenario.feeder.index(b) for b in scenario.inverter_buses]
    if scenario.datacenter_buses is None:
        order = np.argsort(counter.bits(key, counter.PLACEMENT, len(scenario.candidates)), axis=1, kind="stable")
        at = scenario.candidates[order[:, :n_dc]]
    else:
        at = np.tile([scenario.feeder.index(b) for b in scenario.datacenter_buses], (lanes, 1)).astype(np.int64)
    buses = np.concatenate((at, np.tile(np.array(fixed, dtype=np.int64), (lanes, 1))), axis=1)
    rows = trace_pool(scenario).p_share
    # Sites take different rows as long as there are enough.
    row = np.argsort(counter.bits(key, counter.TRACE_ROW, len(rows)), axis=1, kind="stable")
    row = row[:, np.arange(n_dc) % len(rows)]
    room = 1 if scenario.trace_window == "start" else rows.shape[1] - window_steps(scenario) + 1
    start = (counter.bits(key, counter.TRACE_START, n_dc) % np.uint64(room)).astype(np.int64)
    if scenario.trace_window == "together":
        start = start[:, :1]
    window = row * rows.shape[1] + start
    if scenario.site_correlation:
        # The upper 53 bits make a uniform number below 1, so that a correlation of 1 leaves no site out.
        uniform = (counter.bits(key, counter.CORRELATION, n_dc) >> np.uint64(11)) * 2.0**-53
        window = np.where(uniform < scenario.site_correlation, window[:, :1], window)
    sun_row, sun_start = counter.bits(key, counter.SUN, 2).T
    rows, steps = sun_rows(scenario).shape
    sun = sun_row % np.uint64(rows) * np.uint64(steps) + sun_start % np.uint64(steps - scenario.horizon)
    return assemble(scenario, key, buses, window, sun.astype(np.int64), _faults(scenario, key))


def assemble(
    scenario: Scenario, key: np.ndarray, buses: np.ndarray, start: np.ndarray, sun: np.ndarray, fault: np.ndarray
) -> Episode:
    """An episode from what was drawn: adds the positions that depend on which lanes stand together in the batch."""
    return Episode(key, buses, observation.placement(scenario, buses), start, sun, fault)


def _faults(scenario: Scenario, key: np.ndarray) -> np.ndarray:
    """What is lost, from which step on and to which, int64, (lane, n_fault, 3)."""
    drawn = counter.bits(key, counter.FAULT, 3 * len(scenario.faults)).reshape(len(key), -1, 3)
    found = np.empty(drawn.shape, np.int64)

    def steps(times_s: tuple[float, float], between: np.ndarray) -> np.ndarray:
        low, high = (round(min(t_s / scenario.dt_s, FOR_GOOD)) for t_s in times_s)
        return low + (between % np.uint64(high - low + 1)).astype(np.int64)

    for i, (fault, targets) in enumerate(zip(scenario.faults, scenario.fault_targets, strict=True)):
        found[:, i, 0] = targets[drawn[:, i, 0] % np.uint64(len(targets))]
        found[:, i, 1] = 1 + steps(fault.begin_s, drawn[:, i, 1])  # nothing is lost at t = 0
        found[:, i, 2] = found[:, i, 1] + steps(fault.duration_s, drawn[:, i, 2])
    return found


def lost(scenario: Scenario, episode: Episode, step: np.ndarray) -> np.ndarray:
    """What is lost in the interval that ends at ``step`` (lane,), bool: agents, then buses' capacitors.

    (lane, n_agent + n_bus)
    """
    target, begin, end = np.moveaxis(episode.fault, -1, 0)
    struck = (begin <= step[:, None]) & (step[:, None] < end)
    out = np.zeros((len(step), scenario.n_agents + scenario.feeder.n_bus), bool)
    lane, i = np.nonzero(struck)
    out[lane, target[lane, i]] = True
    return out


def p_ref_kw(scenario: Scenario, episode: Episode, step: np.ndarray) -> np.ndarray:
    """What the data centres would draw over the interval that ends at ``step`` (lane,), kW, (lane, n_dc)."""
    return trace_pool(scenario).p_share.take(episode.start + step[:, None]) * scenario.datacenter.p_rated_kw


def compute_share(scenario: Scenario, episode: Episode, step: np.ndarray) -> np.ndarray | None:
    """Compute-bound share of that power above idle, (lane, n_dc); None under a clock law of one phase."""
    if scenario.phases == 1:
        return None
    known = trace_pool(scenario).compute_share
    if known is None:
        return np.full(episode.start.shape, float(scenario.compute_share))
    return known.take(episode.start + step[:, None])


def exogenous(
    scenario: Scenario, episode: Episode, step: np.ndarray, noise: np.ndarray, p_ref: np.ndarray
) -> tuple[Exogenous, np.ndarray]:
    """What comes from outside in the interval that ends at each lane's ``step``, and the load noise behind it.

    Parameters
    ----------
    scenario, episode
        As drawn.
    step
        (lane,) int64; at 0 the noise starts afresh.
    noise
        The AR(1) process one step earlier, (lane, n_bus); anything of that shape at step 0.
    p_ref
        The data centres' p_ref at ``step``, kW, (lane, n_dc): see :func:`p_ref_kw`.
    """
    process_and_loads = np.empty((3, *noise.shape))
    z, p, q = process_and_loads[0], process_and_loads[1], process_and_loads[2]
    load = _load(scenario)

    def part(a: int, b: int) -> int:
        return counter.load_step(episode.key[a:b], step[a:b], noise[a:b], *load, z[a:b], p[a:b], q[a:b])

    if len(step) == 1:
        counter.load_step(episode.key, step, noise, *load, z, p, q)
    else:
        over_lanes(part, len(step))
    if scenario.inverter_trace is None:
        injection = np.zeros((len(step), scenario.n_inverters))
    else:
        injection = sun_rows(scenario).take(episode.sun + step)[:, None] * scenario.inverter.s_rated_kva
    available = None
    if scenario.faults:
        agents, capacitors = np.split(lost(scenario, episode, step), [scenario.n_agents], axis=1)
        available = 1.0 - agents
        q += capacitors * scenario.feeder.capacitor_kvar
    share = compute_share(scenario, episode, step)
    return Exogenous(p, q, p_ref, injection, episode.placed.nodes, share, available), z
