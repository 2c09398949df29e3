"""A data centre of many GPUs: services of language models and training on one site, over the hours of a day.

Each service has its share of the GPUs, a model on them and a load. The load is the mean arrival rate over the rate that
full batches sustain; with small batches the replicas are busy for much more of the time. Sites can share their users:
for the share `correlation` of the time, in blocks of ten minutes, all sites of a group get the same requests. Otherwise
each gets its own. With 0 the sites are independent, with 1 synchronous, and a single site has the same statistics for
every correlation. Training and the idle draw are separate for each site.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from dcgrid_env.traces.checks import FloatArray, TraceError
from dcgrid_env.traces.provenance import generated
from dcgrid_env.traces.serving.hardware import GPUS, Replica
from dcgrid_env.traces.serving.hardware import replica as find_replica
from dcgrid_env.traces.serving.pool import Pool, in_chunks, site_shares
from dcgrid_env.traces.serving.requests import IntArray
from dcgrid_env.traces.serving.services import Service, find_service
from dcgrid_env.traces.time_grid import GRID_S, IDLE_SHARE, as_trace, grid_steps, idle_draw, stream
from dcgrid_env.traces.trace import PowerTrace, RequestTimes
from dcgrid_env.traces.training.training_site import generate_training

BLOCK_S = 600.0
"""Sites share their requests, or not, for this long at a time, s."""
# A trace begins this long after the pools were empty, and goes on for a while so that late requests are answered.
_WARM_UP_S, _TAIL_S = 120.0, 60.0
# About so many requests a second are kept with a trace, the same share of every tenant's.
_KEPT_PER_S = 5.0
# Spread of the logarithm of demand over days: a choice.
_DAY_SPREAD = 0.1


@dataclass(frozen=True)
class Tenant:
    """A service at a site."""

    service: str | Service
    model: str
    gpu_share: float
    """Share of the site's GPUs, in (0, 1]."""
    load: float
    """Mean arrival rate over the rate that full batches sustain."""


@dataclass(frozen=True)
class Site:
    """Parameters of a site.

    Raises TraceError for an unknown GPU, model or service, a number out of range, shares that exceed 1, or a tenant
    without a whole replica.
    """

    gpu: str = "H100"
    n_gpus: int = 266
    """266 H100 are 280 kW."""
    tenants: tuple[Tenant, ...] = (Tenant("chat", "llama3-70b", 1.0, 0.35),)
    training_share: float = 0.0
    """Share of the site's GPUs that train."""
    daily_swing: float = 0.4
    """Share by which the demand rises and falls over the day."""

    def __post_init__(self) -> None:
        if self.gpu not in GPUS:
            raise TraceError(f"Site.gpu = {self.gpu!r} is unknown; choose one of {', '.join(GPUS)}")
        if isinstance(self.n_gpus, bool) or not isinstance(self.n_gpus, int) or self.n_gpus < 1:
            raise TraceError(f"Site.n_gpus = {self.n_gpus!r} is not a whole number of at least 1")
        shares = [self.training_share, *(tenant.gpu_share for tenant in self.tenants)]
        if not all(0.0 <= share <= 1.0 for share in shares) or sum(shares) > 1.0 + 1e-9 or sum(shares) == 0.0:
            raise TraceError(
                f"Site: shares of the GPUs {shares} (training first) must be in 0 to 1 and add up to 0 to 1"
            )
        if not 0.0 <= self.daily_swing <= 1.0:
            raise TraceError(f"Site.daily_swing = {self.daily_swing!r} is not in 0 to 1")
        for tenant in self.tenants:
            if not (math.isfinite(tenant.load) and tenant.load > 0):
                raise TraceError(f"Tenant.load = {tenant.load!r} of {tenant.model!r} is not a finite number above 0")
            self.rate_per_s(tenant)

    @property
    def rated_kw(self) -> float:
        """Rating of the site, kW."""
        return self.n_gpus * GPUS[self.gpu].site_kw

    def replicas(self, tenant: Tenant) -> tuple[Replica, int]:
        """A tenant's replica and how many of them its GPUs make."""
        unit = find_replica(self.gpu, tenant.model)
        n = int(self.n_gpus * tenant.gpu_share + 1e-9) // unit.n_gpus
        if n < 1:
            raise TraceError(
                f"Site: {tenant.gpu_share:g} of {self.n_gpus} {self.gpu} is less than the {unit.n_gpus} that "
                f"{tenant.model!r} needs; give it more GPUs or a smaller model"
            )
        return unit, n

    def rate_per_s(self, tenant: Tenant) -> float:
        """Mean arrival rate of a tenant's requests, 1/s."""
        unit, n = self.replicas(tenant)
        service = find_service(tenant.service)
        return tenant.load * n / unit.busy_s(service.context.mean, service.generated.mean)


def generate_site(
    duration_s: float, seed: int, site: Site | None = None, *, correlation: float = 0.0, group: int | None = None
) -> PowerTrace:
    """Generate the power of a site as a share of its rating.

    Parameters
    ----------
    duration_s : length, s; rounded up to the grid of 0.1 s.
    seed : integer of at least 0. The trace begins at hour `seed` modulo 24 of a day that is drawn for it, which has
        more or less demand than others.
    site : parameters of the site.
    correlation : share of the time in which it gets the same requests as all sites of its group, 0 to 1.
    group : integer of at least 0 that sites which share requests have in common; required if `correlation` is not 0.

    Returns
    -------
    PowerTrace with power in [0.23, 1] of a rating of 1 kW, on a grid of 0.1 s, with a sample of its requests

    Raises
    ------
    TraceError
        If a number is out of range.
    """
    site = site or Site()
    n_steps = grid_steps(duration_s)
    if not 0.0 <= correlation <= 1.0 or (correlation and group is None):
        raise TraceError(
            f"correlation = {correlation!r} with group {group!r}: give 0 to 1, and a group if it is above 0"
        )
    idle = idle_draw(stream("site idle", seed), n_steps)
    group = None if group is None else int(group)
    hour = int(seed) % 24
    share, compute = np.full(n_steps, IDLE_SHARE), np.zeros(n_steps)
    kept: list[FloatArray] = []
    for number, tenant in enumerate(site.tenants):
        demand = _Demand(site, tenant, number, seed, group, correlation, 3600.0 * hour)
        served = np.zeros((2, n_steps))
        kept.append(_serve(site, tenant, demand, served))
        share += served[0]
        compute += served[1]
    if site.training_share:
        part = generate_training(duration_s, seed)
        assert part.compute_kw is not None
        share += site.training_share * (part.power_kw[:-1] - IDLE_SHARE)
        compute += site.training_share * part.compute_kw[:-1]
    # An idle GPU holds its clocks for a while, which draws more than the floor.
    share = np.maximum(share, idle)
    times = None
    if kept:
        table = np.concatenate(kept, axis=1)
        times = RequestTimes(*table[:, np.argsort(table[0], kind="stable")])
    provenance = generated("site", seed, duration_s, site=site, hour=hour, correlation=correlation, group=group)
    return as_trace(share, compute, f"site-{seed}", provenance, times)


def generate_sites(
    n_sites: int, duration_s: float, seed: int, site: Site | None = None, *, correlation: float = 0.0
) -> list[PowerTrace]:
    """Generate sites alike that share their requests for the share `correlation` of the time; see `generate_site`.

    All begin at the same hour, `seed` modulo 24.
    """
    seeds = [seed + 24_000_000 * (k + 1) for k in range(n_sites)]  # the same hour, days of their own
    return [generate_site(duration_s, site_seed, site, correlation=correlation, group=seed) for site_seed in seeds]


class _Demand:
    """A tenant's requests, from the warm-up on; times in s from its beginning."""

    def __init__(self, site, tenant, number, seed, group, correlation, begin_s) -> None:
        service = find_service(tenant.service)
        name = f"site {number} {service.name}"
        # Sites that share requests have their days of more and less in common; others do not.
        day_rng = stream("site day", group if correlation else seed)
        level = math.exp(_DAY_SPREAD * day_rng.standard_normal() - 0.5 * _DAY_SPREAD**2)
        rate = level * site.rate_per_s(tenant)
        law = replace(service.arrivals, rate_per_s=rate, daily_swing=site.daily_swing)
        self.service, self.name, self.seed, self.group = replace(service, arrivals=law), name, seed, group
        self.correlation, self.begin_s = correlation, begin_s - _WARM_UP_S
        self.every = max(1, round(sum(map(site.rate_per_s, site.tenants)) / _KEPT_PER_S))

    def chunks(self, n_steps: int) -> Iterator[tuple[FloatArray, IntArray, IntArray, int]]:
        """Requests of each chunk of steps, and how many steps it has."""
        duration_s = n_steps * GRID_S
        own_chunks = in_chunks(self.service.draw(self.name, self.seed, duration_s, self.begin_s), n_steps)
        if not self.correlation:
            yield from own_chunks
            return
        assert self.group is not None
        blocks = stream("site blocks", self.group).random(math.ceil(duration_s / BLOCK_S) + 1) < self.correlation
        both = in_chunks(self.service.draw(f"{self.name} shared", self.group, duration_s, self.begin_s), n_steps)
        for mine, shared in zip(own_chunks, both, strict=True):
            in_mine, in_shared = (blocks[(part[0] / BLOCK_S).astype(np.int64)] for part in (mine, shared))
            arrival_s = np.concatenate((mine[0][~in_mine], shared[0][in_shared]))
            context = np.concatenate((mine[1][~in_mine], shared[1][in_shared]))
            generated_tokens = np.concatenate((mine[2][~in_mine], shared[2][in_shared]))
            order = np.argsort(arrival_s, kind="stable")
            yield arrival_s[order], context[order], generated_tokens[order], mine[3]


def _serve(site: Site, tenant: Tenant, demand: _Demand, out: FloatArray) -> FloatArray:
    """Put a tenant's draw above idle and its compute-bound part into `out`, (2, n_steps); return the kept requests.

    (4, n): arrival, s from the beginning of the trace, then as in RequestTimes.
    """
    unit, n_replicas = site.replicas(tenant)
    pool = Pool(unit, n_replicas, demand.every)
    weight = n_replicas * unit.n_gpus / site.n_gpus
    warm_up, n_steps = round(_WARM_UP_S / GRID_S), out.shape[1]
    kept, step = [], -warm_up
    for arrival_s, context, generated_tokens, steps in demand.chunks(warm_up + n_steps + round(_TAIL_S / GRID_S)):
        load = pool.advance(arrival_s, context, generated_tokens, steps)
        begin, end = max(step, 0), min(step + steps, n_steps)
        if end > begin:
            within = slice(begin - step, end - step)
            drawn, compute = site_shares(unit.gpu, load.dynamic[within], load.compute[within])
            out[0, begin:end] = weight * (drawn - IDLE_SHARE)
            out[1, begin:end] = weight * compute
        kept.append(load.done[1:])
        step += steps
    while pool.waiting:
        kept.append(pool.rest().done[1:])
    table = np.concatenate(kept, axis=1)
    table[0] -= _WARM_UP_S
    return table[:, (table[0] >= 0.0) & (table[0] < n_steps * GRID_S)]
