"""Interpret the figures of a scenario's check: whether the scenario is worth learning on, and what to change."""

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
"""The paper's reactive gain, Mvar per p.u. and s."""
OUTSIDE = "outside_bus_seconds_pct"


@dataclass(frozen=True)
class Reached:
    """What somebody reached in the first episodes."""

    metrics: dict[str, np.ndarray]
    """By name, (n,) each."""
    parameters: Mapping[str, Any]
    """The parameters of a rule that was fitted."""

    @classmethod
    def from_metrics(
        cls, metrics: Sequence[Mapping[str, float]], parameters: Mapping[str, Any] | None = None
    ) -> Reached:
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
class Figures:
    """What was found of a scenario."""

    reached: Mapping[str, Reached]
    """Controllers by name: those in the table, all on the same episodes, and two further ones."""
    lowest_bus: str
    """Bus of the lowest mean voltage without control."""
    refused: str
    """Reason why hindsight is missing; empty if it is known."""
    largest_k_q: float
    """The largest reactive gain of the droop that is stable by itself, Mvar per p.u. and s."""
    requested_episodes: int
    """Episodes that were asked for; there was time for those that the table is of."""


NO_CONTROL, PAPER, DROOP, CONSTANT, HINDSIGHT = (
    "no control",
    "paper's droop",
    "best droop",
    "best constant",
    "hindsight",
)
"""Names of the controllers in the table."""
BARE, PINNED = "no control without data centres", "hindsight at the top clock"
"""Who is looked at besides."""


@dataclass(frozen=True)
class Verdict:
    """One thing that the figures say."""

    text: str
    remedy: str = ""
    """Recommended change; empty if none is needed."""
    is_bar: bool = False
    """Whether it keeps the scenario from being worth learning on."""

    def __str__(self) -> str:
        return f"{self.text}; {self.remedy}" if self.remedy else self.text


def verdicts(scenario: Scenario, figures: Figures) -> tuple[Verdict, ...]:
    """What the figures say, the sum of it last."""
    reached = figures.reached
    best = reached.get(HINDSIGHT)
    verdict_list = [*_collapses(scenario, reached), *_droop(figures.largest_k_q)]
    if best is None:
        verdict_list.append(
            Verdict(f"hindsight is not known here: {figures.refused}", "judge by what a trained policy reaches")
        )
        return (*verdict_list, *_sum_without_hindsight(reached))
    verdict_list = [*_band(scenario, figures, best), *verdict_list, *_clock(reached)]
    gain = _to_gain(scenario, reached, best)
    barred = any(verdict.is_bar for verdict in (*verdict_list, gain))
    said = f"{scenario.name} is {'not worth learning on as it stands' if barred else 'worth learning on'}"
    few = best.n < figures.requested_episodes
    as_far = f", as far as the first {best.n} of {figures.requested_episodes} episodes tell" if few else ""
    return (*verdict_list, gain, Verdict(f"{said}{as_far}", "give it more --seconds to be sure" if few else ""))


def _collapses(scenario: Scenario, reached: Mapping[str, Reached]) -> list[Verdict]:
    no_control, best = reached[NO_CONTROL], reached.get(HINDSIGHT)
    collapses = []
    if no_control.collapsed:
        collapses.append(
            Verdict(
                f"without control the power flow has no solution in {no_control.collapsed} of {no_control.n} episodes",
                f"{_lower(scenario)} unless collapse is what you study",
            )
        )
    if best is not None and best.collapsed:
        text = f"hopeless: even hindsight ends {best.collapsed} of {best.n} episodes in voltage collapse"
        collapses.append(Verdict(text, _lower(scenario), is_bar=True))
    return collapses


def _band(scenario: Scenario, figures: Figures, best: Reached) -> list[Verdict]:
    """Whether the band can be kept."""
    no_control, bare = figures.reached[NO_CONTROL], figures.reached.get(BARE)
    outside, low, high = (best.mean(OUTSIDE), *_reach(best))
    said = f"in {outside:.1f} % of bus-seconds (voltages {low:.3f} to {high:.3f} p.u.)"
    if outside <= HARD_PCT:
        before = no_control.mean(OUTSIDE)
        text = f"the band can be kept: outside {before:.1f} % of bus-seconds without control, hindsight {said}"
        return [Verdict(text)] if before > HARD_PCT else []
    remedy = _centre(scenario, low, high)
    if bare is not None and bare.mean(OUTSIDE) > 0.5 * outside and remedy == _lower(scenario):
        remedy = (
            f"the feeder's own load leaves it in {bare.mean(OUTSIDE):.1f} % without any data centre: "
            f"{_more_kvar(scenario)} near bus {figures.lowest_bus}, or give the feeder less load"
        )
    hopeless = outside > LOST_PCT
    return [Verdict(f"{'hopeless' if hopeless else 'hard'}: even hindsight leaves the band {said}", remedy, hopeless)]


def _reach(one: Reached) -> tuple[float, float]:
    return float(one.metrics["voltage_min_pu"].min()), float(one.metrics["voltage_max_pu"].max())


def _centre(scenario: Scenario, low: float, high: float) -> str:
    """Remedy that brings voltages into the band: another source voltage if possible, else less load."""
    top, bottom = 1.0 + scenario.cost.band_pu, 1.0 - scenario.cost.band_pu
    taps = int((top - high) / TAP_PU + 1e-9) if low < bottom else -int((low - bottom) / TAP_PU + 1e-9)
    if taps and acting_relays(scenario) is None:
        way = "raise" if taps > 0 else "lower"
        to_pu = scenario.source_voltage_pu + taps * TAP_PU
        return f"{way} source_voltage_pu from {scenario.source_voltage_pu:g} to {to_pu:g}"
    return _lower(scenario) if low < bottom else _more_kvar(scenario) + ", or shed PV" * (scenario.schedule is not None)


def _lower(scenario: Scenario) -> str:
    rated = scenario.datacenters.parameters.p_rated_kw
    if not len(rated):
        return _more_kvar(scenario)
    lower = f"lower the data centres' rating (datacenters.p_rated_kw, now {rated.sum():g} kW in all)"
    return f"{lower} or {_more_kvar(scenario)}"


def _more_kvar(scenario: Scenario) -> str:
    """Recommend more reactive power of inverters than a scenario has."""
    kvar = float(scenario.q_scale_kvar[scenario.datacenters.count :].sum())
    return f"give inverters more than {kvar:g} kvar" if kvar else "add inverters"


def _droop(largest_k_q: float) -> list[Verdict]:
    """Whether the paper's gain is within the linear bound."""
    if not np.isfinite(largest_k_q):
        return []
    said = f"with k_p = 0 the droop is stable up to k_q = {largest_k_q:.3g} Mvar/p.u. s in these episodes"
    if largest_k_q < PAPER_K_Q:
        return [Verdict(f"{said}, below the paper's {PAPER_K_Q:g}", "compare with droop-tuned, not with droop")]
    return [Verdict(said)]


def _clock(reached: Mapping[str, Reached]) -> list[Verdict]:
    """Assess the benefit of clock control."""
    pinned = reached.get(PINNED)
    if pinned is None:
        return []
    free_j, pinned_j = reached[HINDSIGHT].mean("J", pinned.n), pinned.mean("J")
    worth, delay_s = max(0.0, 1.0 - free_j / max(pinned_j, 1e-12)), reached[HINDSIGHT].mean("delay_mean_s", pinned.n)
    said = f"{100 * worth:.1f} % of J to hindsight (work then waits {delay_s:.1f} s on average)"
    if worth < CLOCK_SHARE:
        remedy = "train with --act q, or raise datacenters.p_rated_kw if the clock is what you study"
        return [Verdict(f"the clock hardly matters: it is worth {said}", remedy)]
    return [Verdict(f"the clock matters: it is worth {said}")]


def _to_gain(scenario: Scenario, reached: Mapping[str, Reached], best: Reached) -> Verdict:
    """Compare the best rule with hindsight."""
    rules = {name: reached[name].mean("J") for name in (NO_CONTROL, PAPER, DROOP, CONSTANT)}
    name = min(rules, key=lambda rule: rules[rule])
    j = best.mean("J")
    share = 1.0 - j / max(rules[name], 1e-12)
    of_none = 1.0 - j / max(rules[NO_CONTROL], 1e-12)
    said = f"hindsight is {100 * share:.1f} % below the {name} (J {j:.3f} against {rules[name]:.3f})"
    if name == NO_CONTROL or of_none < NOTHING_SHARE:
        text = f"nothing to gain: hindsight is within {100 * of_none:.1f} % of no control (J {j:.3f})"
        return Verdict(text, _harder(scenario), is_bar=True)
    if share < NOTHING_SHARE:
        return Verdict(f"little is left to learn beyond the {name}: {said}", _harder(scenario), is_bar=True)
    if share < SMALL_SHARE:
        return Verdict(f"there is a little to gain: {said}, {100 * of_none:.0f} % below no control", _harder(scenario))
    return Verdict(f"there is much to gain: {said}, {100 * of_none:.0f} % below no control")


def _harder(scenario: Scenario) -> str:
    """What makes control matter more."""
    rated = scenario.datacenters.parameters.p_rated_kw
    raised = (
        f"raise the data centres' rating (datacenters.p_rated_kw, now {rated.sum():g} kW in all), "
        if len(rated)
        else ""
    )
    return f"{raised}put devices at the ends, or {_more_kvar(scenario)}"


def _sum_without_hindsight(reached: Mapping[str, Reached]) -> list[Verdict]:
    no_control, rules = reached[NO_CONTROL].mean("J"), [reached[name].mean("J") for name in (DROOP, CONSTANT)]
    return [Verdict(f"simple rules are {100 * (1.0 - min(rules) / max(no_control, 1e-12)):.1f} % below no control")]
