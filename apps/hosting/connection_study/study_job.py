"""A connection request and the capacity study that answers it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.apps.hosting.capacity_study import Study
from dcgrid_env.apps.hosting.connection_study.study_request import StudyRequest
from dcgrid_env.apps.hosting.hosting import study_controller
from dcgrid_env.apps.hosting.site_scenario import with_sites
from dcgrid_env.baselines.source_voltage import source_line, source_origin


@dataclass(frozen=True)
class Job:
    """A request and the study that answers it."""

    request: StudyRequest
    study: Study
    outages: Mapping[str, Scenario] = field(default_factory=dict)
    """The study's scenario with each requested outage, by the name of the outage."""

    @property
    def sized(self) -> int:
        """The requested rating in steps of the study, rounded up."""
        return int(np.ceil(self.request.mw / self.study.step_mw - 1e-9))

    @property
    def source(self) -> str:
        """The source voltage and where it comes from, in a line."""
        requested, scenario = self.request.set.get("source_voltage_pu"), self.study.scenario
        return source_line(
            scenario, source_origin(scenario, requested, self.request.scenario, "[set] of the study's file")
        )

    def scenario(self, mw: float, **changes: Any) -> Scenario:
        """The study's scenario with a site of a rating at the requested bus, 0 MW for none, and other changes."""
        return with_sites(self.study, (self.request.bus,), (mw,), **changes)

    def controllers(self) -> list[tuple[str, Any]]:
        """The controllers of the request by name."""
        return [(name, study_controller(name, self.study.scenario, None)[0]) for name in self.request.controllers]
