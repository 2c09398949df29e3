"""A scenario with one data centre more: of any size, at any bus, in any of a study's sampled windows."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from dcgrid_env import DcgridVectorEnv, Scenario
from dcgrid_env.baselines.hosting_capacity.capacity_study import Study

_NOTHING_KW = 1e-3
"""Rating that stands for no site: a device has a rating."""


class AddedSite:
    """The scenarios of a study, one for each size, and the arguments that reset their episodes.

    The site is the last of the scenario's data centres and shares all but its rating with them. Where it stands is a
    matter of the environment, so many buses and samples of a size run as one batch; the size is one of the scenario.
    """

    def __init__(self, study: Study, exempt: np.ndarray | None = None):
        self.study = study
        self.exempt = np.zeros(study.scenario.feeder.n_node, bool) if exempt is None else exempt
        """Nodes whose branch does not count as overloaded, since it is so without any site."""
        self.slot = study.scenario.datacenters.count if study.others else 0
        """Which of the data centres it is."""
        self.scenario = lru_cache(maxsize=512)(self._scenario)
        """The scenario with a site of so many steps of size; 0 for none."""
        first = self.scenario(0)
        self.agent = first.agents.index(f"dc_{self.slot}")
        """Which of the agents it is."""
        self._buses = self._buses_of_samples(first)

    def mw(self, size: int) -> float:
        """A size in MW."""
        return float(f"{size * self.study.step_mw:.10g}")

    def reset_arguments(self, buses: np.ndarray, samples: np.ndarray) -> tuple[list[int], dict[str, Any]]:
        """Seeds, and options of the reset, of a batch with the site at positions ``buses`` in ``samples``, (row,)."""
        placed = self._buses[samples].copy()
        placed[:, self.agent] = buses
        options: dict[str, Any] = {"buses": placed}
        if self.study.load == "day":
            options["begin_h"] = self.study.hours[samples]
        return samples.tolist(), options

    def _scenario(self, size: int) -> Scenario:
        study, base = self.study, self.study.scenario
        kw = 1000.0 * self.mw(size) if size else _NOTHING_KW
        changed: dict[str, Any] = {
            "horizon": study.horizon,
            "background.start_hour": "random" if study.load == "day" else None,
            "workload.full_load_s": study.full_load_s,
            "n_datacenters": self.slot + 1,
            "datacenters.buses": self._datacenter_buses(),
            "datacenters.p_rated_kw": (*(base.datacenters.parameters.p_rated_kw.tolist() if study.others else ()), kw),
        }
        if not study.others:
            changed |= {"inverters.buses": (), "inverters.s_rated_kva": 0.0}
        return base.replace(**changed)

    def _datacenter_buses(self) -> tuple[str, ...] | None:
        """Where the scenario has its sites; the added one anywhere free, as each environment sets its true bus."""
        scenario, others = self.study.scenario, self.study.others
        there = scenario.datacenters.buses if others else ()
        if there is None:
            return None
        taken = {str(bus) for device in scenario.devices for bus in getattr(device, "buses", None) or () if others}
        free = [bus for bus in scenario.feeder.bus_ids[1:] if bus not in taken]
        if not free:
            raise ValueError(f"scenario {scenario.name!r} has a device at every bus; leave one bus without")
        return (*map(str, there), free[0])

    def _buses_of_samples(self, scenario: Scenario) -> np.ndarray:
        """Position of each agent's bus in each sample, (sample, n_agent): as fixed in the study's scenario or drawn."""
        env = DcgridVectorEnv(self.study.samples, scenario, info="none")
        env.reset(seed=0)
        index = scenario.feeder.index
        placed = np.array([[index(bus) for bus in bus_ids] for bus_ids in env.buses()])
        env.close()
        return placed
