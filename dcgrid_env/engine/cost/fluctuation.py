"""How unsteady an episode was: flicker at the buses, swings and ramps of the sites, changes of the voltage.

Flicker and swings are there where steps are of at most 0.1 s and an episode lasts at least 600 s. The time after the
last full 600 s is left out; an episode that ended before the first counts as far as it went. A step of dt shows
frequencies up to 1 / (2 dt), so with 0.1 s the band of swings ends at 5 Hz. Ramps are there where the scenario has
``cost.ramp_limit_kw_per_s``, voltage steps where it has ``cost.voltage_step_limit_pu``; see ``utility_limits``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env.core.checked import FieldError
from dcgrid_env.core.metric import Combined, Metric
from dcgrid_env.engine.cost.flicker import INTERVAL_S, LARGEST_DT_S, StreamingFlicker, check_sampling, severity
from dcgrid_env.scenario.costs.utility_limits import excess, ramp_steps, ramps_kw_per_s, sites, voltage_step_excess
from dcgrid_env.scenario.scenario import Scenario

SWING_BAND_HZ = (0.1, 20.0)
"""Frequencies at which utilities fear swings of a load (arXiv 2508.14318)."""


METRICS = (
    Metric("pst_max", "largest Pst", "", 2, "lower",
        "largest short-term flicker Pst of a node in 600 s, lamp of 120 V and 60 Hz", over_episodes="max",
        tables=("run",)),
    Metric("swing_share_max_pct", "swing at 0.1 to 20 Hz", "% of all swing", 1, "lower",
        "largest share of a site's swing, the square of its draw's difference from the mean, at 0.1 to 20 Hz",
        over_episodes="max", tables=("run",)),
    Metric("swing_rms_max_pct", "rms swing at 0.1 to 20 Hz", "% of rating", 1, "lower",
        "largest root mean square of that part of a site's draw, as a share of its rating", over_episodes="max"),
    Metric("ramp_max_kw_per_s", "steepest ramp", "kW/s", 1, "lower",
        "steepest ramp of a site over the limit's window", "max", over_episodes="max"),
    Metric("ramp_excess_pct", "ramp excess", "% of the limit", 2, "lower",
        "mean over sites and steps of the excess of ramps over the limit", "mean", tables=("run",)),
    Metric("voltage_step_max_pu", "largest voltage step", "p.u.", 4, "lower",
        "largest change of a node's voltage in a step", "max", over_episodes="max"),
    Metric("voltage_step_excess_pct", "voltage step excess", "% of the limit", 2, "lower",
        "mean over nodes and steps of the excess of those changes over the limit", "mean"),
)  # fmt: skip
"""Flicker, swings, ramps and voltage steps."""


class WorstFlicker(NamedTuple):
    """Where an episode flickers most."""

    pst: float
    node: str
    """Bus, or bus and phase on a three-phase feeder, such as "671.b"."""
    begin_s: float
    """When its 600 s begin, s after the reset."""


class Swing(NamedTuple):
    """What of a draw lies in a band of frequencies."""

    share: np.ndarray
    """Part of the energy of the draw's difference from its mean, (n_site,); 0 of a constant draw."""
    rms_kw: np.ndarray
    """Root mean square of that part, kW, (n_site,)."""


def shows_flicker(scenario: Scenario) -> bool:
    """Whether an episode of the scenario is fine and long enough for flicker and for swings of a load."""
    return scenario.dt_s <= LARGEST_DT_S + 1e-9 and scenario.horizon * scenario.dt_s >= INTERVAL_S - 1e-6


def worst_flicker(scenario: Scenario, v_pu: np.ndarray, lamp: str = "120V-60Hz") -> WorstFlicker:
    """Largest Pst of a node but the substation's, of voltages over the steps of an episode, p.u., (step, n_node).

    ValueError where steps are too coarse or an episode is too short for flicker, see :func:`shows_flicker`.
    """
    check_sampling(scenario.dt_s)
    if not shows_flicker(scenario):
        least = int(np.ceil(INTERVAL_S / scenario.dt_s - 1e-6))
        raise FieldError("flicker", "horizon", scenario.horizon, f"give an episode of at least {least} steps, 600 s")
    feeder = scenario.feeder
    pst = severity(v_pu[:, feeder.load_slice], scenario.dt_s, lamp)
    interval, column = np.unravel_index(pst.argmax(), pst.shape)
    node = feeder.node_ids[feeder.load_nodes[column]]
    return WorstFlicker(float(pst[interval, column]), node, float(interval) * INTERVAL_S)


def swing(p_kw: np.ndarray, dt_s: float, band_hz: tuple[float, float] = SWING_BAND_HZ) -> Swing:
    """What of draws ``p_kw`` (step, n_site), steps of ``dt_s``, lies in a band of frequencies, both ends counted in.

    ValueError for a band that steps of this length do not show any of, or that is none.
    """
    low_hz, high_hz = band_hz
    if not 0.0 < low_hz < high_hz or low_hz > 0.5 / dt_s:
        raise FieldError(
            "swing", "band_hz", band_hz, f"give two rising frequencies above 0 Hz, one below {0.5 / dt_s:g}"
        )
    n = len(p_kw)
    spectrum = np.abs(np.fft.rfft(p_kw - p_kw.mean(axis=0), axis=0)) ** 2
    twice = np.full(len(spectrum), 2.0)  # each frequency stands for its negative too, but for 0 and the highest
    twice[0] = 1.0
    if n % 2 == 0:
        twice[-1] = 1.0
    mean_square = spectrum * (twice / n**2)[:, None]  # which sums to that of the difference (Parseval)
    frequency_hz = np.fft.rfftfreq(n, dt_s)
    inside = (frequency_hz >= low_hz - 1e-9) & (frequency_hz <= high_hz + 1e-9)
    within, whole = mean_square[inside].sum(axis=0), mean_square.sum(axis=0)
    moves = whole > (1e-9 * np.abs(p_kw).max(axis=0)) ** 2  # less is rounding
    return Swing(np.divide(within, whole, out=np.zeros_like(whole), where=moves), np.sqrt(np.where(moves, within, 0.0)))


def swing_figures(scenario: Scenario, p_kw: np.ndarray) -> dict[str, float]:
    """Figures of the swings of the sites' draws over the steps of an episode, kW, (step, n_site)."""
    band = swing(p_kw, scenario.dt_s)
    return {
        "swing_share_max_pct": 100.0 * float(band.share.max(initial=0.0)),
        "swing_rms_max_pct": 100.0 * float((band.rms_kw / scenario.site_rated_kw).max(initial=0.0)),
    }


class StreamingFluctuation:
    """Accumulates those figures of the module's table that the scenario has."""

    def __init__(self, scenario: Scenario):
        self.scenario = scenario
        self._combined = Combined(METRICS)
        self._before: np.ndarray | None = None
        """Draws of the sites over the window of a ramp, (ramp_steps, n_site)."""
        self._flicker = StreamingFlicker(scenario.dt_s) if shows_flicker(scenario) else None
        self._draws: list[np.ndarray] = []

    def add(self, v_pu: np.ndarray, p_kw: np.ndarray) -> None:
        """Take a part: voltages, p.u., and draws of the agents, kW, (step + 1, ..) each."""
        s, steps = self.scenario, len(v_pu) - 1
        v, own_kw = v_pu[:, s.feeder.load_slice], p_kw[:, sites(s)]
        if self._flicker is not None:
            self._flicker.add(v[1:])
            self._draws.append(own_kw[1:].copy())
        figures: dict[str, float] = {}
        if s.cost.ramp_limit_kw_per_s is not None:
            window = ramp_steps(s)
            if self._before is None:
                self._before = np.repeat(own_kw[:1], window, axis=0)
            course = np.concatenate((self._before, own_kw[1:]))
            ramps = ramps_kw_per_s(s, own_kw[1:], course[:steps])
            self._before = course[-window:].copy()
            figures["ramp_max_kw_per_s"] = float(ramps.max())
            figures["ramp_excess_pct"] = 100.0 * float(excess(ramps, s.cost.ramp_limit_kw_per_s).mean())
        if s.cost.voltage_step_limit_pu is not None:
            figures["voltage_step_max_pu"] = float(np.abs(np.diff(v, axis=0)).max())
            figures["voltage_step_excess_pct"] = 100.0 * float(voltage_step_excess(s, v[1:], v[:-1]).mean())
        self._combined.add(figures, steps)

    def figures(self) -> dict[str, float]:
        """The figures of all parts so far."""
        if self._flicker is None:
            return self._combined.figures()
        swings = swing_figures(self.scenario, np.concatenate(self._draws))
        return {"pst_max": self._flicker.largest()} | swings | self._combined.figures()
