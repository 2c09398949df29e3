"""What the figures of a scenario's check say in plain words: whether it is worth learning on, and what to change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dcgrid_env import Scenario, acting_relays
from dcgrid_env.baselines.source_voltage import TAP_PU

NOTHING_SHARE = 0.02
"""Share of J by which hindsight must be ahead of the best rule for there to be something to learn."""
SMALL_SHARE = 0.05
"""Share below which it is little."""
CLOCK_SHARE = 0.01
"""Share of J that the clock must be worth to matter."""
LOST_PCT, HARD_PCT = 10.0, 1.0
"""Share of bus-seconds that hindsight leaves outside the band from which it is lost, or hard to keep, %."""
PAPER_K_Q = 0.5


@dataclass(frozen=True)
class Reached:
    """What somebody reached in the first episodes."""

    metrics: dict[str, np.ndarray]
    """By name, (n,) each."""
    parameters: Mapping[str, Any]
    """Of a rule that was fitted."""

    @classmethod
    def of(cls, metrics: Sequence[Mapping[str, float]], parameters: Mapping[str, Any] | None = None) -> Reached:
        """From the metrics of each episode."""
        return cls({name: np.array([m[name] for m in metrics]) for name in metrics[0]}, parameters or {})

    @property
    def n(self) -> int:
        """Number of episodes."""
        return len(self.metrics["J"])

    def mean(self, name: str, n: int | None = None) -> float:
        """Mean of a metric over the first n episodes, or all."""
        return float(self.metrics[name][:n].mean())

    @property
    def collapsed(self) -> int:
        """Episodes that ended without a solution of the power flow."""
        return int((self.metrics["power_flow_converged"] == 0.0).sum())


@dataclass(frozen=True)
class Verdict:
    """One thing that the figures say."""

    text: str
    remedy: str = ""
    """What to change; empty where there is no need."""
    is_bar: bool = False
    """Whether it keeps the scenario from being worth learning on."""

    def __str__(self) -> str:
        return f"{self.text}; {self.remedy}" if self.remedy else self.text


def verdicts(
    scenario: Scenario, reached: Mapping[str, Reached], refused: str, largest_k_q: float
) -> tuple[Verdict, ...]:
    """What the figures say, the sum of it last.

    Parameters
    ----------
    scenario
        What was looked at.
    reached
        By the names of ``scenario_check``.
    refused
        Why there is no hindsight, if there is none.
    largest_k_q
        The droop's largest stable reactive gain, Mvar per p.u. and s.
    """
    best_possible = reached.get("hindsight")
    found = [*_collapses(scenario, reached), *_droop(largest_k_q)]
    if best_possible is None:
        found.append(Verdict(f"hindsight is not known here: {refused}", "judge by what a trained policy reaches"))
        return (*found, *_sum_without_hindsight(reached))
    found = [*_band(scenario, reached["no control"], best_possible), *found, *_clock(scenario, reached)]
    gain = _to_gain(scenario, reached, best_possible)
    barred = any(verdict.is_bar for verdict in (*found, gain))
    said = "not worth learning on as it stands" if barred else "worth learning on"
    return (*found, gain, Verdict(f"{scenario.name} is {said}"))


def _collapses(scenario: Scenario, reached: Mapping[str, Reached]) -> list[Verdict]:
    none, best = reached["no control"], reached.get("hindsight")
    found = []
    if none.collapsed:
        found.append(
            Verdict(
                f"without control the power flow has no solution in {none.collapsed} of {none.n} episodes",
                f"{_lower(scenario)} unless collapse is what you study",
            )
        )
    if best is not None and best.collapsed:
        text = f"hopeless: even hindsight ends {best.collapsed} of {best.n} episodes in voltage collapse"
        found.append(Verdict(text, _lower(scenario), is_bar=True))
    return found


def _band(scenario: Scenario, none: Reached, best: Reached) -> list[Verdict]:
    """Whether the band can be kept."""
    outside, low, high = (best.mean("outside_bus_seconds_pct"), *_reach(best))
    said = f"in {outside:.1f} % of bus-seconds (voltages {low:.3f} to {high:.3f} p.u.)"
    if outside > LOST_PCT:
        return [Verdict(f"hopeless: even hindsight leaves the band {said}", _centre(scenario, low, high), is_bar=True)]
    if outside > HARD_PCT:
        return [Verdict(f"hard: even hindsight leaves the band {said}", _centre(scenario, low, high))]
    before = none.mean("outside_bus_seconds_pct")
    if before > HARD_PCT:
        return [Verdict(f"the band can be kept: outside {before:.1f} % of bus-seconds without control, hindsight {said}")]
    return []


def _reach(one: Reached) -> tuple[float, float]:
    return float(one.metrics["voltage_min_pu"].min()), float(one.metrics["voltage_max_pu"].max())


def _centre(scenario: Scenario, low: float, high: float) -> str:
    """What brings voltages into the band: another source voltage where that is room for, else less load."""
    top, bottom = 1.0 + scenario.band_pu, 1.0 - scenario.band_pu
    taps = int((top - high) / TAP_PU + 1e-9) if low < bottom else -int((low - bottom) / TAP_PU + 1e-9)
    if taps and acting_relays(scenario) is None:
        way = "raise" if taps > 0 else "lower"
        return f"{way} source_voltage_pu from {scenario.source_voltage_pu:g} to {scenario.source_voltage_pu + taps * TAP_PU:g}"
    return _lower(scenario) if low < bottom else f"give inverters more than {_kvar(scenario)} kvar, or shed PV"


def _lower(scenario: Scenario) -> str:
    rated = scenario.datacenter.p_rated_kw
    if not len(rated):
        return f"give inverters more than their {_kvar(scenario)} kvar"
    return f"lower the data centres' rating (p_rated_kw, now {rated.sum():g} kW in all) or give inverters more kvar"


def _kvar(scenario: Scenario) -> str:
    return f"{scenario.q_scale_kvar[scenario.n_datacenters :].sum():g}"


def _droop(largest_k_q: float) -> list[Verdict]:
    """Whether the paper's gain is within the linear bound."""
    if not np.isfinite(largest_k_q):
        return []
    said = f"the droop's reactive gain is stable up to k_q = {largest_k_q:.3g} Mvar/p.u. s"
    if largest_k_q < PAPER_K_Q:
        return [Verdict(f"{said}, below the paper's {PAPER_K_Q:g}", "compare with droop-tuned, not with droop")]
    return [Verdict(said)]


def _clock(scenario: Scenario, reached: Mapping[str, Reached]) -> list[Verdict]:
    """What the clock is worth."""
    pinned = reached.get("hindsight at the top clock")
    if pinned is None:
        return []
    free_j, pinned_j = reached["hindsight"].mean("J", pinned.n), pinned.mean("J")
    worth, delay_s = 1.0 - free_j / max(pinned_j, 1e-12), reached["hindsight"].mean("delay_mean_s", pinned.n)
    said = f"{100 * worth:.1f} % of J to hindsight (work then waits {delay_s:.1f} s on average)"
    if worth < CLOCK_SHARE:
        remedy = "train with --act q, or raise p_rated_kw if the clock is what you study"
        return [Verdict(f"the clock hardly matters: it is worth {said}", remedy)]
    return [Verdict(f"the clock matters: it is worth {said}")]


def _to_gain(scenario: Scenario, reached: Mapping[str, Reached], best: Reached) -> Verdict:
    """How far the best rule is from hindsight."""
    rules = {name: one.mean("J", best.n) for name, one in reached.items() if not name.startswith("hindsight")}
    name = min(rules, key=lambda rule: rules[rule])
    j = best.mean("J")
    share = 1.0 - j / max(rules[name], 1e-12)
    of_none = 1.0 - j / max(rules["no control"], 1e-12)
    said = f"hindsight is {100 * share:.1f} % below the {name} (J {j:.3f} against {rules[name]:.3f})"
    if name == "no control" or of_none < NOTHING_SHARE:
        text = f"nothing to gain: hindsight is within {100 * of_none:.1f} % of no control (J {j:.3f})"
        return Verdict(text, _harder(scenario), is_bar=True)
    if share < NOTHING_SHARE:
        return Verdict(f"little is left to learn beyond the {name}: {said}", _harder(scenario), is_bar=True)
    if share < SMALL_SHARE:
        return Verdict(f"there is a little to gain: {said}, {100 * of_none:.0f} % below no control", _harder(scenario))
    return Verdict(f"there is much to gain: {said}, {100 * of_none:.0f} % below no control")


def _harder(scenario: Scenario) -> str:
    """What makes control matter more."""
    rated = scenario.datacenter.p_rated_kw
    raised = f"raise the data centres' rating (p_rated_kw, now {rated.sum():g} kW in all), " if len(rated) else ""
    return f"{raised}put devices at the ends, or give inverters more than {_kvar(scenario)} kvar"


def _sum_without_hindsight(reached: Mapping[str, Reached]) -> list[Verdict]:
    none, rules = reached["no control"].mean("J"), [reached[name].mean("J") for name in ("best droop", "best constant")]
    return [Verdict(f"simple rules are {100 * (1.0 - min(rules) / max(none, 1e-12)):.1f} % below no control")]
