"""An episode as drawn: placement, trace windows, time of day, faults and noise, all functions of one key per row."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core import random
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.devices import Work
from dcgrid_env.engine.exogenous.clock_starts import row_clocks, starts_on_clock
from dcgrid_env.engine.exogenous.drawn_events import drawn_faults, drawn_sags, sags_in_interval
from dcgrid_env.engine.exogenous.drawn_requests import drawn_requests, request_columns
from dcgrid_env.engine.exogenous.profile_loads import drawn_start_h, profile_loads
from dcgrid_env.engine.exogenous.trace_pool import (
    HOURS,
    full_trace_kw,
    has_hourly_rows,
    sun_rows,
    trace_pool,
    window_steps,
)
from dcgrid_env.engine.physics import connections
from dcgrid_env.engine.physics.loads import drawn
from dcgrid_env.engine.physics.state import Exogenous, LoadsToDraw
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.scenario.scenario import Scenario
from dcgrid_env.traces import SUN, RowsOnDemand, load_share, sun_share

_ROUNDING_S = 1e-9


class EpisodeOptions(NamedTuple):
    """Properties of an episode that a caller sets; those that are None are drawn."""

    buses: np.ndarray | None = None
    """Position in ``bus_ids`` of each agent's bus, (row, n_agent)."""
    begin_h: np.ndarray | None = None
    """Time of day at t = 0, h in [0, 24), (row,), of a scenario that follows the day; with load profiles h since the
    midnight before the file's first sample."""


class Episode(NamedTuple):
    """What a reset draws, for a batch of rows."""

    key: np.ndarray
    """(row,) uint64."""
    buses: np.ndarray
    """Position in ``bus_ids`` of each agent's bus, (row, n_agent)."""
    placed: connections.Placement
    start: np.ndarray
    """Where each data centre's trace window begins, flat position row * n_step + step of the pool, (row, n_site)."""
    sun: np.ndarray
    """Where the window of generated PV begins, flat position row * n_step + step of its pool, (row,); 0 without PV."""
    begin_h: np.ndarray
    """Time of day at t = 0, h in [0, 24), (row,); 0 where nothing follows the day. With load profiles it is h since the
    midnight before the file's first sample, so it may be beyond 24."""
    still: np.ndarray
    """Ones, (row,): the share of the nominal load where nothing follows the day."""
    fault: np.ndarray
    """What each fault strikes (see ``Scenario.fault_targets``), the first step without it and the first with it again,
    int64, (row, n_fault, 3)."""
    sag: np.ndarray
    """Beginning, duration and share left of each sag, ``drawn_events.drawn_sags``, (row, n_sag, 3)."""
    request: np.ndarray
    """Start, ramp, duration and value of each request, ``drawn_requests.drawn_requests``, (row, n_request, 4)."""


def prepare(scenario: Scenario, episode: Episode) -> None:
    """Have the rows of trace that an episode's windows lie in, where they are made on demand.

    Drawing it here does so; an episode that was drawn in another process or environment needs it.
    """
    pool = trace_pool(scenario)
    if isinstance(pool, RowsOnDemand):
        pool.make(episode.start // pool.p_share.shape[1])


def draw(scenario: Scenario, seeds: np.ndarray, numbers: np.ndarray, options: EpisodeOptions | None = None) -> Episode:
    """Draw an episode for each row from its seed and the number of episodes since it was seeded, both (row,) uint64.

    The split is part of the key, so two splits never share an episode, whatever their seeds. The values in ``options``
    do not change other draws, except for windows of requests that follow the hour.
    """
    options = options or EpisodeOptions()
    salt = np.uint64(zlib.crc32(scenario.generator_split.encode()))
    key = random.keys(salt, seeds, numbers)
    buses = _buses(scenario, key) if options.buses is None else options.buses
    begin_h = _begin_h(scenario, key) if options.begin_h is None else options.begin_h
    sun_row, sun_start = random.bits(key, random.SUN, 2).T
    rows, steps = sun_rows(scenario).shape
    sun = sun_row % np.uint64(rows) * np.uint64(steps) + sun_start % np.uint64(steps - scenario.horizon)
    drawn = (
        _windows(scenario, key, begin_h),
        sun.astype(np.int64),
        begin_h,
        drawn_faults(scenario, key),
        drawn_sags(scenario, key),
        drawn_requests(scenario, key),
    )
    episode = assemble(scenario, key, buses, *drawn)
    prepare(scenario, episode)
    return episode


def _buses(scenario: Scenario, key: np.ndarray) -> np.ndarray:
    """Position of each agent's bus, (row, n_agent): as fixed, or drawn evenly among the free load buses."""
    order = None
    parts, taken = [], 0
    for device in scenario.devices:
        if device.buses is not None:
            fixed = np.array([scenario.feeder.index(bus) for bus in device.buses], dtype=np.int64)
            parts.append(np.tile(fixed, (len(key), 1)))
            continue
        if order is None:
            drawn = random.bits(key, random.PLACEMENT, len(scenario.candidates))
            order = np.argsort(drawn, axis=1, kind="stable")
        parts.append(scenario.candidates[order[:, taken : taken + device.count]])
        taken += device.count
    return np.concatenate(parts, axis=1)


def _begin_h(scenario: Scenario, key: np.ndarray) -> np.ndarray:
    """Time of day at t = 0, h, (row,); with load profiles h since the midnight before the file's first sample."""
    if scenario.load_profiles.file is not None:
        return drawn_start_h(scenario, random.uniform(key, random.HOUR, 1)[:, 0])
    if isinstance(scenario.background.start_hour, str) or (
        scenario.background.start_hour is None and scenario.follows_day
    ):
        return 24.0 * random.uniform(key, random.HOUR, 1)[:, 0]
    return np.full(len(key), float(scenario.background.start_hour or 0.0))


def _windows(scenario: Scenario, key: np.ndarray, begin_h: np.ndarray) -> np.ndarray:
    """Where each data centre's trace window begins, see ``Episode.start``."""
    pool, n_site = trace_pool(scenario), scenario.n_sites
    n_rows, n_steps = pool.p_share.shape
    # Sites take different rows as long as there are enough.
    hourly = has_hourly_rows(scenario)
    n_choices = n_rows // HOURS if hourly else n_rows
    row = np.argsort(random.bits(key, random.TRACE_ROW, n_choices), axis=1, kind="stable")
    row = row[:, np.arange(n_site) % n_choices]
    spare = pool.spare_steps if isinstance(pool, RowsOnDemand) else n_steps - window_steps(scenario)
    room = 1 if scenario.workload.window == "start" else spare + 1
    drawn = random.bits(key, random.TRACE_START, n_site)
    if scenario.workload.window == "together":
        drawn = drawn[:, :1]
    clocks = row_clocks(scenario.family)
    if clocks is None:
        start = (drawn % np.uint64(room)).astype(np.int64)
    else:
        start, _ = starts_on_clock(scenario, clocks, row, begin_h, drawn)
    if isinstance(pool, RowsOnDemand) and pool.begin_h is not None and scenario.follows_day:
        # Requests follow the hour of the day, so a window begins where its row has reached the episode's.
        if hourly:
            hour = np.floor(begin_h - pool.begin_h[0]).astype(np.int64) % HOURS
            row = HOURS * row + hour[:, None]
        later_h = (begin_h[:, None] - pool.begin_h[row]) % 24.0
        start = start + np.floor(later_h * 3600.0 / scenario.dt_s).astype(np.int64)
    window = row * n_steps + start
    if scenario.workload.site_correlation:
        window = np.where(
            random.uniform(key, random.CORRELATION, n_site) < scenario.workload.site_correlation, window[:, :1], window
        )
    return window


def assemble(
    scenario: Scenario,
    key: np.ndarray,
    buses: np.ndarray,
    start: np.ndarray,
    sun: np.ndarray,
    begin_h: np.ndarray,
    fault: np.ndarray,
    sag: np.ndarray,
    request: np.ndarray,
) -> Episode:
    """An episode from what was drawn: adds the positions that depend on which rows are together in the batch."""
    still = np.ones(len(key))
    placed = connections.placement(scenario, buses)
    return Episode(key, buses, placed, start, sun, begin_h, still, fault, sag, request)


def lost(scenario: Scenario, fault: np.ndarray, step: np.ndarray) -> np.ndarray:
    """What ``Episode.fault`` takes in the interval that ends at ``step`` (row,), bool: agents, then capacitors.

    (row, n_agent + n_bus), or n_capacitor instead of n_bus on a three-phase feeder.
    """
    target, begin, end = np.moveaxis(fault, -1, 0)
    struck = (begin <= step[:, None]) & (step[:, None] < end)
    out = np.zeros((len(step), scenario.n_agents + len(scenario.capacitor_connected)), bool)
    row, i = np.nonzero(struck)
    out[row, target[row, i]] = True
    return out


def p_ref_kw(scenario: Scenario, episode: Episode, step: np.ndarray) -> np.ndarray:
    """What the data centres would draw over the interval that ends at ``step`` (row,), kW, (row, n_site)."""
    return asked_kw(scenario, episode.start, step)


def asked_kw(scenario: Scenario, start: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Power that sites ask for in windows from ``start`` on, broadcast against ``step`` (n,), kW, (n, n_site)."""
    p_kw = trace_pool(scenario).p_share.take(start + step[:, None]) * full_trace_kw(scenario)
    if scenario.workload.full_load_s is None:
        return p_kw
    begin_s, end_s = scenario.workload.full_load_s
    t_s = step[:, None] * scenario.dt_s
    full = (begin_s + _ROUNDING_S < t_s) & (t_s <= end_s + _ROUNDING_S)
    return np.where(full, np.maximum(p_kw, scenario.site_rated_kw), p_kw)


def compute_share(scenario: Scenario, episode: Episode, step: np.ndarray) -> np.ndarray | None:
    """Compute-bound share of that power above idle, (row, n_site); None under a clock law of one work class."""
    if scenario.work_classes == 1:
        return None
    shares = trace_pool(scenario).compute_share
    if shares is None:
        return np.full(episode.start.shape, float(scenario.workload.compute_share))
    return shares.take(episode.start + step[:, None])


def given_next(scenario: Scenario, episode: Episode, step: np.ndarray, p_ref_next: np.ndarray) -> tuple[Any, ...]:
    """Return the inputs of the coming interval that devices can observe at ``step`` (row,): work only, by device."""
    shares = None if scenario.work_classes == 1 else compute_share(scenario, episode, step + 1)
    work = Work(p_ref_next, shares)
    return tuple([work if works else None for works in _driven_by_workload(scenario)])


@cached_on_owner
def _driven_by_workload(scenario: Scenario) -> tuple[bool, ...]:
    """Return for each device whether the workload drives it."""
    return tuple(device.input == "workload" for device in scenario.devices)


def exogenous(
    scenario: Scenario,
    episode: Episode,
    step: np.ndarray,
    noise: np.ndarray,
    p_ref: np.ndarray,
) -> Exogenous:
    """External inputs of the interval that ends at each row's ``step``, with loads that are not drawn yet.

    Parameters
    ----------
    scenario, episode
        The scenario, and what a reset drew of it for each row.
    step
        (row,) int64; at 0 the noise starts afresh.
    noise
        The AR(1) process one step earlier, (row, n_bus); anything of that shape at step 0.
    p_ref
        The data centres' p_ref at ``step``, kW, (row, n_site): see :func:`p_ref_kw`.
    """
    hour = episode.begin_h + step * (scenario.dt_s / 3600.0) if scenario.follows_day else None
    share = episode.still if hour is None else load_share(hour)
    schedule = scenario.schedule
    rated_kva = scenario.scheduled_kva
    if schedule is None:
        injection = np.zeros((len(step), len(rated_kva)))
    else:
        injection = sun_rows(scenario).take(episode.sun + step)[:, None] * rated_kva
        if hour is not None and schedule == SUN:
            injection *= sun_share(hour)[:, None]
    three_phase = isinstance(scenario.feeder, ThreePhaseFeeder)
    available = capacitor_on = None
    if three_phase and not scenario.background.capacitors:
        capacitor_on = np.zeros((len(step), len(scenario.capacitor_connected)))
    if scenario.faults:
        agents, capacitors = np.split(lost(scenario, episode.fault, step), [scenario.n_agents], axis=1)
        available = 1.0 - agents
        capacitor_on = 1.0 - capacitors
        if three_phase:
            capacitor_on *= float(scenario.background.capacitors)
    placed, compute = episode.placed, compute_share(scenario, episode, step)
    legs = placed.legs if three_phase else None
    sags = sags_in_interval(scenario, episode.sag, step)
    to_draw = LoadsToDraw(episode.key, step, noise, share)
    if hour is not None and scenario.load_profiles.file is not None:
        p_kw, q_kvar = profile_loads(scenario, hour)
        to_draw = to_draw._replace(share=episode.still, p_kw=p_kw, q_kvar=q_kvar)
    offset_v, settings = None, scenario.grid_control.regulator_settings
    if settings.has_schedules:
        begin_h = episode.begin_h + np.maximum(step - 1, 0) * (scenario.dt_s / 3600.0)  # of the interval
        offset_v = settings.scheduled_v(scenario.feeder.network.regulator, begin_h)
    return Exogenous(
        None, None, p_ref, injection, placed.nodes, compute, available, legs, capacitor_on, sags, None, to_draw,
        offset_v, request_columns(scenario, episode.request, step, p_ref),
    )  # fmt: skip


def unroll(scenario: Scenario, episode: Episode) -> Iterator[tuple[np.ndarray, Exogenous]]:
    """The steps 0 .. T of an episode in turn, (row,), each with what comes from outside in its interval."""
    noise = np.zeros((len(episode.key), scenario.feeder.n_bus))
    for k in range(scenario.horizon + 1):
        step = np.full(len(episode.key), k)
        p_ref = p_ref_kw(scenario, episode, step)
        outside, noise = drawn(scenario, exogenous(scenario, episode, step, noise, p_ref))
        yield step, outside
