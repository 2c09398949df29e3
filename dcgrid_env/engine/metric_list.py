"""The metrics of an episode as tables show them; what each means stands in ``metrics``, which computes them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Metric:
    """How a metric is written."""

    name: str
    """Its name in records, with the unit of its value."""
    label: str
    """What tables call it."""
    unit: str
    """Unit of what is shown; empty for a number without one."""
    decimals: int
    """Digits after the point."""
    better: Literal["lower", "higher", "neither"]
    """Which of two values is to be preferred, all else equal."""
    short: str = ""
    """Heading of a narrow column, with the unit; that of other tables where it is empty."""
    scale: float = 1.0
    """What a value is multiplied by where it is shown."""
    over_episodes: Literal["mean", "min", "max"] = "mean"
    """How the values of several episodes become one."""

    @property
    def heading(self) -> str:
        """Label and unit."""
        return f"{self.label}, {self.unit}" if self.unit else self.label

    @property
    def column(self) -> str:
        """Heading of a narrow column."""
        return self.short or self.heading

    def is_worse(self, means: Mapping[str, float], others: Mapping[str, float]) -> bool:
        """Whether it is worse in the first of two records, as far as the digits that are shown tell."""
        own, other = (round(self.scale * record[self.name], self.decimals) for record in (means, others))
        return {"lower": own > other, "higher": own < other, "neither": False}[self.better]

    def text(self, value: float) -> str:
        """The value as tables show it, without its unit."""
        return f"{self.scale * value:.{self.decimals}f}"


_METRICS = (
    Metric("J", "J", "", 4, "lower"),
    Metric("cost_voltage", "voltage cost", "", 4, "lower"),
    Metric("cost_violation", "violation cost", "", 4, "lower"),
    Metric("cost_backlog", "backlog cost", "", 4, "lower"),
    Metric("cost_effort", "effort cost", "", 4, "lower"),
    Metric("cost_clock", "clock movement cost", "", 4, "lower"),
    Metric("cost_step", "voltage step cost", "", 4, "lower"),
    Metric("cost_loss", "loss cost", "", 4, "lower"),
    Metric("cost_leftover", "leftover work cost", "", 4, "lower"),
    Metric("cost_ageing", "ageing cost of storage", "", 4, "lower"),
    Metric("cost_missing", "cost of missing energy", "", 4, "lower"),
    Metric("cost_site_ageing", "ageing cost of storage behind sites", "", 4, "lower"),
    Metric("cost_site_missing", "cost of missing energy behind sites", "", 4, "lower"),
    Metric("cost_unbalance", "unbalance cost", "", 4, "lower"),
    Metric("cost_switching", "switching cost", "", 4, "lower"),
    Metric("cost_ramp_excess", "ramp excess cost", "", 4, "lower"),
    Metric("cost_voltage_step_excess", "voltage step excess cost", "", 4, "lower"),
    Metric("cost_overload", "overload cost", "", 4, "lower"),
    Metric("voltage_deviation_mean_pu", "mean |V-1|", "p.u.", 4, "lower"),
    Metric("voltage_deviation_std_pu", "std of |V-1|", "p.u.", 4, "lower"),
    Metric("outside_bus_seconds_pct", "bus-seconds outside", "%", 2, "lower", short="outside, % of bus-s"),
    Metric("outside_buses_pct", "buses ever outside", "%", 1, "lower"),
    Metric("voltage_min_pu", "lowest voltage", "p.u.", 3, "neither", over_episodes="min"),
    Metric("voltage_max_pu", "highest voltage", "p.u.", 3, "neither", over_episodes="max"),
    Metric("voltage_step_mean_pu", "1-step voltage change", "1e-3 p.u.", 2, "lower", scale=1e3),
    Metric("delay_mean_s", "mean delay", "s", 2, "lower"),
    Metric("delay_p50_s", "50 % of work within", "s", 1, "lower", short="p50 delay, s"),
    Metric("delay_p95_s", "95 % of work within", "s", 1, "lower", short="p95 delay, s"),
    Metric("delay_p99_s", "99 % of work within", "s", 1, "lower", short="p99 delay, s"),
    Metric("arrived_kws", "work that arrived", "kW s", 1, "neither"),
    Metric("unserved_kws", "unserved at the end", "kW s", 1, "lower", short="unserved, kW s"),
    Metric("loss_mean_kw", "mean loss", "kW", 1, "lower"),
    Metric("loss_energy_kwh", "energy lost", "kWh", 2, "lower"),
    Metric("q_effort_pct", "effort", "% of rating", 1, "lower"),
    Metric("clock_mean_pct", "mean clock", "% of the top clock", 1, "higher"),
    Metric("unbalance_mean_pct", "mean voltage unbalance", "%", 2, "lower"),
    Metric("unbalance_max_pct", "highest voltage unbalance", "%", 2, "lower", over_episodes="max"),
    Metric("nema_unbalance_max_pct", "highest NEMA unbalance", "%", 2, "lower", over_episodes="max"),
    Metric("tap_moves", "taps moved", "", 1, "lower"),
    Metric("capacitor_switchings", "capacitor switchings", "", 1, "lower"),
    Metric("pst_max", "largest Pst", "", 2, "lower", over_episodes="max"),
    Metric("swing_share_max_pct", "swing at 0.1 to 20 Hz", "% of all swing", 1, "lower", over_episodes="max"),
    Metric("swing_rms_max_pct", "rms swing at 0.1 to 20 Hz", "% of rating", 1, "lower", over_episodes="max"),
    Metric("ramp_max_kw_per_s", "steepest ramp", "kW/s", 1, "lower", over_episodes="max"),
    Metric("ramp_excess_pct", "ramp excess", "% of the limit", 2, "lower"),
    Metric("voltage_step_max_pu", "largest voltage step", "p.u.", 4, "lower", over_episodes="max"),
    Metric("voltage_step_excess_pct", "voltage step excess", "% of the limit", 2, "lower"),
    Metric("loading_max_pct", "highest loading of a branch", "% of its rating", 1, "lower", over_episodes="max"),
    Metric("overloaded_branch_seconds_pct", "branch-seconds above the rating", "%", 2, "lower"),
    Metric("stored_end_pct", "stored at the end", "%", 1, "neither"),
    Metric("stored_lowest_pct", "least stored", "%", 1, "neither", over_episodes="min"),
    Metric("storage_throughput_kwh", "throughput of storage", "kWh", 2, "lower"),
    Metric("storage_loss_kwh", "energy lost in storage", "kWh", 2, "lower"),
    Metric("storage_missing_kwh", "energy missing in storage", "kWh", 2, "lower"),
    Metric("site_stored_end_pct", "stored at the end behind sites", "%", 1, "neither"),
    Metric("site_stored_lowest_pct", "least stored behind sites", "%", 1, "neither", over_episodes="min"),
    Metric("site_storage_throughput_kwh", "throughput of storage behind sites", "kWh", 2, "lower"),
    Metric("site_storage_loss_kwh", "energy lost in storage behind sites", "kWh", 2, "lower"),
    Metric("site_storage_missing_kwh", "energy missing in storage behind sites", "kWh", 2, "lower"),
    Metric("cost_trips", "trip cost", "", 4, "lower"),
    Metric("cost_inverter_trips", "inverter trip cost", "", 4, "lower"),
    Metric("cost_away", "cost of time away", "", 4, "lower"),
    Metric("cost_recharge", "cost of energy missing in UPS", "", 4, "lower"),
    Metric("ups_trips", "sites tripped", "", 1, "lower"),
    Metric("ups_lost_kw", "load lost", "kW", 1, "lower"),
    Metric("ups_lost_step_kw", "load lost in a step", "kW", 1, "lower", over_episodes="max"),
    Metric("ups_away_s", "site-seconds away", "s", 1, "lower"),
    Metric("ups_locked_s", "site-seconds locked out", "s", 1, "lower"),
    Metric("ups_all_back_s", "until all are back", "s", 1, "lower"),
    Metric("battery_work_kws", "work on battery", "kW s", 1, "neither"),
    Metric("battery_energy_kws", "energy of UPS used", "kW s", 1, "lower"),
    Metric("battery_missing_kws", "energy missing in UPS", "kW s", 1, "lower"),
    Metric("cost_burnt", "cost of burnt power", "", 4, "lower"),
    Metric("burnt_kwh", "energy burnt", "kWh", 2, "lower"),
    Metric("burnt_pct", "energy burnt, share", "% of the computers'", 1, "lower"),
    Metric("held_back_kws", "work held back by ramps", "kW s", 1, "lower"),
    Metric("floor_mean_pct", "mean floor", "% of the rating", 1, "neither"),
    Metric("cooling_kwh", "energy of cooling", "kWh", 2, "lower"),
    Metric("pue", "PUE", "", 3, "lower"),
    Metric("inverter_trips", "inverters tripped", "", 1, "lower"),
    Metric("inverter_away_s", "inverter-seconds away", "s", 1, "lower"),
    Metric("voltage_after_loss_max_pu", "highest voltage after a loss", "p.u.", 3, "lower", over_episodes="max"),
    Metric("cost_moving", "cost of moves", "", 4, "lower"),
    Metric("cost_gathering", "cost of gathering batches", "", 4, "lower"),
    Metric("cost_late", "cost of late work", "", 4, "lower"),
    Metric("moved_kws", "work moved", "kW s", 1, "neither"),
    Metric("moved_pct", "work moved", "% of what arrived", 1, "neither"),
    Metric("batch_mean", "mean batch", "requests", 1, "neither"),
    Metric("in_time_pct", "work in time", "%", 2, "higher"),
    Metric("interactive_in_time_pct", "interactive work in time", "%", 2, "higher"),
    Metric("deferrable_in_time_pct", "deferrable work in time", "%", 2, "higher"),
    Metric("lateness_mean_s", "mean lateness", "s", 2, "lower"),
    Metric("lateness_p95_s", "95 % of work late by at most", "s", 1, "lower", short="p95 lateness, s"),
    Metric("steps", "steps done", "", 0, "neither"),
    Metric("power_flow_converged", "power flow converged", "", 0, "higher"),
    Metric("requests_sampled", "requests sampled", "", 0, "neither"),
    Metric("requests_unfinished_pct", "requests unfinished", "%", 1, "lower"),
    Metric("ttft_mean_s", "time to first token, mean", "s", 2, "lower"),
    Metric("ttft_p50_s", "time to first token, 50 %", "s", 2, "lower"),
    Metric("ttft_p95_s", "time to first token, 95 %", "s", 2, "lower"),
    Metric("ttft_p99_s", "time to first token, 99 %", "s", 2, "lower"),
    Metric("e2e_mean_s", "end to end, mean", "s", 2, "lower"),
    Metric("e2e_p50_s", "end to end, 50 %", "s", 2, "lower"),
    Metric("e2e_p95_s", "end to end, 95 %", "s", 2, "lower"),
    Metric("e2e_p99_s", "end to end, 99 %", "s", 2, "lower"),
)
METRICS: dict[str, Metric] = {metric.name: metric for metric in _METRICS}
"""Every metric of an episode by its name."""
