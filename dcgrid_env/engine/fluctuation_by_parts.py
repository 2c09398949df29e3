"""How unsteady an episode was, of a course that comes in parts: what ``fluctuation`` makes of a whole one.

Flicker takes the voltages of one interval of 600 s at a time. A spectrum takes a whole course: where steps are fine
enough for swings, the sites' draws are kept, 8 bytes a site and step.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.metric import Combined
from dcgrid_env.engine.flicker import FlickerByParts
from dcgrid_env.engine.fluctuation import METRICS, shows_flicker, swing_figures
from dcgrid_env.scenario.costs.utility_limits import excess, ramp_steps, ramps_kw_per_s, sites, voltage_step_excess
from dcgrid_env.scenario.scenario import Scenario


class FluctuationByParts:
    """Accumulates the figures of ``fluctuation.fluctuation``."""

    def __init__(self, scenario: Scenario):
        self.scenario = scenario
        self._combined = Combined(METRICS)
        self._before: np.ndarray | None = None
        """Draws of the sites over the window of a ramp, (ramp_steps, n_site)."""
        self._flicker = FlickerByParts(scenario.dt_s) if shows_flicker(scenario) else None
        self._draws: list[np.ndarray] = []

    def add(self, v_pu: np.ndarray, p_kw: np.ndarray) -> None:
        """Take a part: voltages, p.u., and draws of the agents, kW, (step + 1, ..) each."""
        s, steps = self.scenario, len(v_pu) - 1
        v, own_kw = v_pu[:, s.feeder.load_slice], p_kw[:, sites(s)]
        if self._flicker is not None:
            self._flicker.add(v[1:])
            self._draws.append(own_kw[1:].copy())
        figures: dict[str, float] = {}
        if s.ramp_limit_kw_per_s is not None:
            window = ramp_steps(s)
            if self._before is None:
                self._before = np.repeat(own_kw[:1], window, axis=0)
            course = np.concatenate((self._before, own_kw[1:]))
            ramps = ramps_kw_per_s(s, own_kw[1:], course[:steps])
            self._before = course[-window:].copy()
            figures["ramp_max_kw_per_s"] = float(ramps.max())
            figures["ramp_excess_pct"] = 100.0 * float(excess(ramps, s.ramp_limit_kw_per_s).mean())
        if s.voltage_step_limit_pu is not None:
            figures["voltage_step_max_pu"] = float(np.abs(np.diff(v, axis=0)).max())
            figures["voltage_step_excess_pct"] = 100.0 * float(voltage_step_excess(s, v[1:], v[:-1]).mean())
        self._combined.add(figures, steps)

    def figures(self) -> dict[str, float]:
        """Those of all parts so far."""
        if self._flicker is None:
            return self._combined.figures()
        swings = swing_figures(self.scenario, np.concatenate(self._draws))
        return {"pst_max": self._flicker.largest()} | swings | self._combined.figures()
