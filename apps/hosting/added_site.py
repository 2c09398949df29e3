"""Add one data centre to a study's scenario, of any size, at any bus, in any of the sampled windows."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from dcgrid_env import DcgridVectorEnv, Scenario
from dcgrid_env.apps.hosting.capacity_study import Study
from dcgrid_env.apps.hosting.load_hours import Windows, sampled_windows
from dcgrid_env.apps.hosting.site_scenario import free_bus, with_sites
from dcgrid_env.powerflow import n_loading


class AddedSite:
    """The scenarios of a study, one for each size, and the arguments that reset their episodes.

    The site is the last of the scenario's data centres and has the same fields as these except for its rating. Its bus
    is set for each environment, so many buses and windows of a size run as one batch. Its size is set by the scenario.

    Parameters
    ----------
    study
        The study.
    windows
        Its windows; None for the sampled ones alone.
    exempt
        See the attribute.
    """

    def __init__(self, study: Study, windows: Windows | None = None, exempt: np.ndarray | None = None):
        self.study = study
        self.windows = sampled_windows(study) if windows is None else windows
        """Windows of sampled load, and those at the worst hours."""
        self.exempt = np.zeros(n_loading(study.scenario.feeder), bool) if exempt is None else exempt
        """Positions in the loading of branches that are not counted, since they are overloaded without any site."""
        self.slot = study.scenario.datacenters.count if study.others else 0
        """Position of the site among the data centres."""
        self.scenario = lru_cache(maxsize=512)(self._scenario)
        """Function that returns the scenario with a site of the given number of size steps, 0 for no site, and whether
        its loads are without noise."""
        first = self.scenario(0)
        self.agent = first.agents.index(f"dc_{self.slot}")
        """Position of the site among the agents."""
        self._buses = self._sample_buses(first)

    def mw(self, size: int) -> float:
        """Convert a size to MW."""
        return float(f"{size * self.study.step_mw:.10g}")

    def reset_arguments(self, buses: np.ndarray, samples: np.ndarray) -> tuple[list[int], dict[str, Any]]:
        """Return seeds and reset options of a batch with the site at ``buses`` in windows ``samples``, (row,) each."""
        placed = self._buses[samples].copy()
        placed[:, self.agent] = buses
        return samples.tolist(), {"buses": placed} | self.windows.options(samples)

    def _scenario(self, size: int, still: bool = False) -> Scenario:
        fields = self.study.window_fields | ({"background.load_sigma": 0.0} if still else {})
        return with_sites(self.study, free_bus(self.study), (self.mw(size),), **fields)

    def _sample_buses(self, scenario: Scenario) -> np.ndarray:
        """Position of each agent's bus in each sample, (sample, n_agent): as fixed in the study's scenario or drawn."""
        n = len(self.windows)
        drawn = any(device.buses is None and device.count for device in scenario.devices)
        env = DcgridVectorEnv(n if drawn else 1, scenario, info="none")
        env.reset(seed=0)
        index = scenario.feeder.index
        placed = np.array([[index(bus) for bus in bus_ids] for bus_ids in env.buses()])
        env.close()
        return np.broadcast_to(placed, (n, placed.shape[1]))
