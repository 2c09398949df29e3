"""Checks of a scenario's fields: each refusal names the field, its value and what would do."""

from __future__ import annotations

import math
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, NoReturn, get_args

import numpy as np

from dcgrid_env.devices import work_classes_of
from dcgrid_env.devices.faults import KINDS, Fault
from dcgrid_env.grid import Feeder, FeederError
from dcgrid_env.traces import ALL_SPLITS, SUN, TRACE_SOURCES, PowerTrace

if TYPE_CHECKING:
    from dcgrid_env.scenario.scenario import Scenario

PowerFlowName = Literal["distflow", "lindistflow"]
VoltageCost = Literal["l1", "l2", "bowl", "courant_beltrami", "bump"]
RewardScope = Literal["shared", "local"]
ObservationScope = Literal["local", "neighbours", "feeder"]
TraceWindow = Literal["random", "start", "together"]
RecordingSplit = Literal["time", "recording"]

_CHOICES = {
    "power_flow": get_args(PowerFlowName),
    "voltage_cost": get_args(VoltageCost),
    "reward": get_args(RewardScope),
    "observe": get_args(ObservationScope),
    "trace_window": get_args(TraceWindow),
    "recording_split": get_args(RecordingSplit),
    "split": ALL_SPLITS,
    "capacitors": (True, False),
    "preview": (True, False),
}
_RANGES: dict[str, tuple[float, float | str]] = {  # a bound may be another field, checked before it
    "v0_pu": (0.5, 1.5),
    "idle_share": (0.0, 0.99),
    "s_rated_share": (1.0, math.inf),
    "q_max_share": (0.0, "s_rated_share"),
    "f_max_mhz": (1e-9, math.inf),
    "f_min_mhz": (1e-9, "f_max_mhz"),
    "boost_share": (1.0, 2.0),
    "site_correlation": (0.0, 1.0),
    "compute_share": (0.0, 1.0),
    "load_sigma": (0.0, 0.3),
    "load_rho": (0.0, 0.999999),
    "voltage_noise_pu": (0.0, 1.0),
    "dt_s": (1e-3, 3600.0),
    "band_pu": (0.0, 1.0),
    "r_model_share": (0.0, 10.0),
    "x_model_share": (0.0, 10.0),
}
_COUNTS = {"n_datacenters": (0, 10_000), "horizon": (1, 100_000_000), "measurement_delay": (0, 10_000)}
LARGEST_RATING = 1e9
"""Of a device, kW or kVA: a thousand gigawatts."""


class ScenarioError(ValueError):
    """A scenario that cannot be; the message names the field, its value and what would do."""


class CostWeights(NamedTuple):
    """Weights of the cost terms (see ``reward``); a term at weight 0 is not charged and is 0 in ``info``."""

    voltage: float = 100.0
    violation: float = 1000.0
    backlog: float = 0.3
    effort: float = 0.02
    leftover: float = 9.0
    clock: float = 0.0
    step: float = 0.0
    loss: float = 0.0


def check(s: Scenario) -> None:
    """Raise ScenarioError at the first field that cannot be."""
    if not isinstance(s.name, str) or not s.name.strip():
        raise ScenarioError(f"scenario {s.name!r}: name is {s.name!r}; give a text that is not empty")
    if not isinstance(s.feeder, Feeder):
        _refuse(s, "feeder", "give a Feeder (load_feeder(name) or Feeder.from_csv(folder))")
    for name, (low, bound) in _RANGES.items():
        value = getattr(s, name)
        high = getattr(s, bound) if isinstance(bound, str) else bound
        if not _is_number(value) or not low <= value <= min(high, 1e300):
            upper = f"{bound} = {high:g}" if isinstance(bound, str) else f"{high:g}"
            _refuse(s, name, f"give a finite number in [{low:g}, {upper}]")
    for name, (low, high) in _COUNTS.items():
        value = getattr(s, name)
        if not isinstance(value, Integral) or isinstance(value, bool) or not low <= int(value) <= high:
            _refuse(s, name, f"give a whole number of at least {low} and at most {high:,}")
    for name, choices in _CHOICES.items():
        value = getattr(s, name)
        if type(value) is not type(choices[0]) or value not in choices:
            _refuse(s, name, f"choose one of {', '.join(map(str, choices))}")
    if s.start_hour not in (None, "random") and not (_is_number(s.start_hour) and 0 <= s.start_hour < 24):
        _refuse(s, "start_hour", "give an hour from 0 to less than 24, 'random', or None")
    if not isinstance(s.weights, CostWeights):
        _refuse(s, "weights", "give CostWeights(voltage=..., ...) or a mapping such as {'backlog': 0.3}")
    for name, value in s.weights._asdict().items():
        if not _is_number(value) or not 0 <= value < math.inf:
            raise ScenarioError(f"scenario {s.name!r}: weights.{name} is {value!r}; give a finite number >= 0")
    if isinstance(s.dvfs, type) or not callable(getattr(s.dvfs, "serve", None)):
        _refuse(s, "dvfs", "give 'linear', 'prefill-decode', or a clock law such as PrefillDecodeDvfs()")
    if hasattr(s.dvfs, "phases") and not hasattr(s.dvfs, "work_classes"):  # its older name
        _refuse(s, "dvfs", "the law says 'phases'; name that attribute 'work_classes'")
    if work_classes_of(s.dvfs) not in (1, 2):
        _refuse(s, "dvfs", f"give a clock law of 1 or 2 work classes, not {work_classes_of(s.dvfs)!r}")
    _check_ratings(s)
    _check_placement(s)
    _check_traces(s)
    _check_faults(s)


def _refuse(s: Scenario, name: str, remedy: str) -> NoReturn:
    raise ScenarioError(f"scenario {s.name!r}: {name} is {getattr(s, name)!r}; {remedy}")


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _check_ratings(s: Scenario) -> None:
    if not isinstance(s.inverter_buses, tuple):
        _refuse(s, "inverter_buses", "give a tuple of buses, () for none")
    for name, n in (("p_rated_kw", s.n_datacenters), ("inverter_s_kva", s.n_inverters)):
        value = getattr(s, name)
        values = value if isinstance(value, tuple) else (value,) * n
        if len(values) != n or not all(_is_number(v) and 0 < v <= LARGEST_RATING for v in values):
            remedy = f"give one positive number of at most {LARGEST_RATING:g}, or one for each of the {n} devices"
            _refuse(s, name, remedy)


def _check_placement(s: Scenario) -> None:
    fixed = list(s.inverter_buses)
    if s.datacenter_buses is not None:
        if not isinstance(s.datacenter_buses, tuple) or len(s.datacenter_buses) != s.n_datacenters:
            raise ScenarioError(
                f"scenario {s.name!r}: n_datacenters is {s.n_datacenters}, but datacenter_buses is "
                f"{s.datacenter_buses!r}; give both, n_datacenters={s.n_datacenters} and as many datacenter_buses, or "
                "datacenter_buses=None to have them drawn among the load buses"
            )
        fixed += s.datacenter_buses
    for bus in fixed:
        if isinstance(bus, bool) or not isinstance(bus, int | str):
            raise ScenarioError(f"scenario {s.name!r}: bus {bus!r} is no number or text; give one of the feeder's")
        try:
            at = s.feeder.index(bus)
        except FeederError as error:
            raise ScenarioError(f"scenario {s.name!r}: {error}") from None
        if at == 0:
            raise ScenarioError(
                f"scenario {s.name!r}: a device at the substation {bus!r}, whose voltage is held; choose another bus"
            )
        if fixed.count(bus) > 1:
            raise ScenarioError(f"scenario {s.name!r}: more than one device at bus {bus!r}; give each its own")
    if s.datacenter_buses is None and s.n_datacenters > len(s.candidates):
        raise ScenarioError(
            f"scenario {s.name!r}: n_datacenters is {s.n_datacenters}, but only {len(s.candidates)} load buses have no "
            "device; ask for fewer or name datacenter_buses"
        )
    if s.n_agents == 0:
        raise ScenarioError(
            f"scenario {s.name!r}: no data centre and no inverter, hence no agent; give n_datacenters or inverter_buses"
        )


def _check_traces(s: Scenario) -> None:
    if isinstance(s.trace, str):
        if s.trace not in TRACE_SOURCES:
            _refuse(s, "trace", f"choose one of {', '.join(TRACE_SOURCES)}, or give recordings")
    elif not isinstance(s.trace, tuple) or not s.trace or not all(isinstance(t, PowerTrace) for t in s.trace):
        _refuse(s, "trace", "give a source's name, a PowerTrace or a tuple of them")
    if isinstance(s.inverter_trace, tuple):
        wrong = [share for share in s.inverter_trace if not _is_number(share) or not -1 <= share <= 1]
        if wrong or len(s.inverter_trace) < s.horizon + 1:
            raise ScenarioError(
                f"scenario {s.name!r}: inverter_trace has {len(s.inverter_trace)} shares"
                + (f", {wrong[0]!r} among them" if wrong else "")
                + f"; give {s.horizon + 1} numbers from -1 to 1, for t = 0 and each step"
            )
    elif not (s.inverter_trace is None or s.inverter_trace == SUN):
        if not isinstance(s.inverter_trace, PowerTrace):
            remedy = f"give {SUN!r}, a PowerTrace as a share of the rating, shares for each step, or None"
            _refuse(s, "inverter_trace", remedy)
        highest = float(np.max(s.inverter_trace.power_kw))
        if highest > 1.0:
            raise ScenarioError(
                f"scenario {s.name!r}: inverter_trace rises to {highest:g}, but it is a share of the inverter's "
                "rating; scale it, for instance trace.scaled_to(1.0)"
            )


def _check_faults(s: Scenario) -> None:
    if not isinstance(s.faults, tuple) or not all(isinstance(fault, Fault) for fault in s.faults):
        _refuse(s, "faults", "give a tuple of Fault, () for none")
    for fault in s.faults:
        for name in fault.among:
            if name not in KINDS and name not in s.agents:
                raise ScenarioError(
                    f"scenario {s.name!r}: a fault among {name!r}; choose {', '.join(KINDS)} or an agent, "
                    f"{', '.join(s.agents)}"
                )
    for fault, targets in zip(s.faults, s.fault_targets, strict=True):
        if not len(targets):
            raise ScenarioError(
                f"scenario {s.name!r}: a fault among {', '.join(fault.among)}, of which there is none; name others"
            )
