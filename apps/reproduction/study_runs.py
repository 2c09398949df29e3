"""Runs of the study: a scenario under a law over all episodes, each done once however often it is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from dcgrid_env import Scenario, Series, make_scenario, scenario_hash
from dcgrid_env.apps.reproduction.load import Load
from dcgrid_env.apps.reproduction.paper import COUNTS, PUBLISHED_BUSES
from dcgrid_env.apps.reproduction.sampled_droop import SampledDroop
from dcgrid_env.baselines import Controller, Droop, NoControl, rollout
from dcgrid_env.baselines.laws.droop import Memory

Placement = Literal["random", "published"]
HEAD_PU = 1.04375
"""Voltage behind the substation's regulator at its published tap, the source at 1 p.u."""


class Law(NamedTuple):
    """The paper's law, or a part of it."""

    acts: Literal["nobody", "inverters", "all"] = "all"
    k_p_mw_per_pu: float = 1.0
    k_q_mvar_per_pu_s: float = 0.5
    memory: Memory = "cumulative"
    hold_steps: int = 1
    alpha_per_s: float = 0.3

    def controller(self) -> Controller:
        """A fresh controller."""
        if self.acts == "nobody":
            return NoControl()
        gains: dict[str, Any] = {
            "k_p_mw_per_pu": self.k_p_mw_per_pu,
            "k_q_mvar_per_pu_s": self.k_q_mvar_per_pu_s,
            "alpha_per_s": self.alpha_per_s,
            "memory": self.memory,
        }
        if self.hold_steps > 1:
            return SampledDroop(**gains, hold_steps=self.hold_steps)
        return Droop(**gains, datacenters=self.acts == "all")


NO_CONTROL = Law("nobody")
INVERTERS = Law("inverters")
REACTIVE = Law(k_p_mw_per_pu=0.0)
BOTH = Law()


@dataclass(frozen=True)
class Setting:
    """Settings of the study; an invalid value raises ValueError."""

    load: Load
    episodes: int = 20
    placement: Placement = "random"
    base: str = "ieee123"
    """The scenario of the IEEE 123 node feeder that the runs are done on."""
    fields: Mapping[str, Any] = field(default_factory=dict)
    """Fields of it that are to be otherwise."""
    sites: tuple[int, ...] = PUBLISHED_BUSES
    """Buses of data centres that are not drawn, from the public code, in its order."""

    def __post_init__(self) -> None:
        if self.episodes < 2:
            raise ValueError(f"episodes is {self.episodes}; give at least 2, so that there is a spread")
        if self.placement not in get_args(Placement):
            raise ValueError(f"placement is {self.placement!r}; choose one of {', '.join(get_args(Placement))}")

    @property
    def counts(self) -> tuple[int, ...]:
        """Numbers of data centres: the paper's, and all of ``sites`` where these are asked for."""
        return COUNTS if self.placement == "random" else tuple(sorted({*COUNTS, len(self.sites)}))

    def scenario(self, n: int, **overrides: object) -> Scenario:
        """The IEEE 123-bus study with ``n`` data centres, placed as asked for."""
        if self.placement == "published":
            return self.published(n, **overrides)
        return make_scenario(self.base, **{"n_datacenters": n, **self.load.fields, **self.fields, **overrides})

    def published(self, n: int, **overrides: object) -> Scenario:
        """The scenario with the data centres at the first ``n`` of ``sites``."""
        return self.pinned(self.sites[:n], **overrides)

    def pinned(self, buses: tuple[int, ...], **overrides: object) -> Scenario:
        """The scenario with the data centres at ``buses``."""
        fields = {"n_datacenters": len(buses), "datacenters.buses": buses, **self.load.fields}
        return make_scenario(self.base, **{**fields, **self.fields, **overrides})

    def with_head_at_1pu(self, n: int) -> Scenario:
        """Data centres at the first ``n`` of ``sites``, and 1 p.u. behind the substation regulator's published tap."""
        scenario = self.published(n)
        return make_scenario(scenario, source_voltage_pu=scenario.source_voltage_pu / HEAD_PU)


class Run(NamedTuple):
    """Figures of each episode (``metrics``, and those of :func:`_more`)."""

    episodes: tuple[dict[str, float], ...]

    def each(self, key: str) -> np.ndarray:
        """A figure of every episode, (n_episode,)."""
        return np.array([figures[key] for figures in self.episodes])

    def mean(self, key: str) -> float:
        """Mean over the episodes."""
        return float(self.each(key).mean())

    @property
    def deviation_pu(self) -> float:
        """Mean abs(V - 1) over buses, steps and episodes."""
        return self.mean("voltage_deviation_mean_pu")


class Runs:
    """The runs of a study, each computed once.

    Parameters
    ----------
    setting
        Its episodes are those of the seeds 0, 1, ...
    """

    def __init__(self, setting: Setting):
        self.setting = setting
        self.done: dict[tuple[str, Law], Run] = {}
        """Computed runs by the scenario's hash, which is the same in every process, and the law."""

    def run(self, scenario: Scenario, law: Law) -> Run:
        """The episodes of a scenario under a law."""
        key = (_hash_of(scenario), law)
        if key not in self.done:
            recorder = rollout(scenario, law.controller(), range(self.setting.episodes))
            episodes = (recorder.series(i) for i in range(self.setting.episodes))
            self.done[key] = Run(tuple(series.metrics() | _more(series) for series in episodes))
        return self.done[key]

    def series(self, scenario: Scenario, law: Law, seed: int) -> Series:
        """Return the time series of one episode."""
        return rollout(scenario, law.controller(), [seed]).series(0)


@lru_cache(maxsize=1024)
def _hash_of(scenario: Scenario) -> str:
    """The hash of a scenario, which is asked for again with every figure of a run."""
    return scenario_hash(scenario)


def nodes_of(scenario: Scenario, bus: int | str) -> list[int]:
    """The nodes of a bus: one on a balanced feeder, its phases on a three-phase one."""
    return list(scenario.feeder.nodes_at(scenario.feeder.index(bus)))


def _more(series: Series) -> dict[str, float]:
    """Figures of squared voltages, which the public code calls voltages; of the second half; of a fixed first site.

    It is outside the band where one of its phases is.
    """
    s = series.scenario
    v = series.v_pu[1:, s.feeder.load_slice]
    squared = np.abs(v**2 - 1.0)
    figures = {
        "squared_deviation_mean_pu": float(squared.mean()),
        "squared_deviation_std_pu": float(squared.std()),
        "squared_outside_buses_pct": float(100.0 * (squared > s.cost.band_pu).any(axis=0).mean()),
        "above_1pu_pct": float(100.0 * (v > 1.0).mean()),
        "late_deviation_pu": float(np.abs(v[len(v) // 2 :] - 1.0).mean()),
    }
    if s.datacenters.buses:
        site = series.v_pu[1:, nodes_of(s, s.datacenters.buses[0])]
        figures["first_site_deviation_pu"] = float(np.abs(site - 1.0).mean())
        figures["first_site_min_pu"] = float(site.min())
        figures["first_site_outside_pct"] = float(100.0 * (np.abs(site - 1.0) > s.cost.band_pu).any(axis=1).mean())
    return figures
