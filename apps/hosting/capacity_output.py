"""Format the results of a study as a table for the terminal, as CSV and as plain data."""

from __future__ import annotations

import csv
import dataclasses
import io
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from dcgrid_env import scenario_hash
from dcgrid_env.apps.hosting.element_names import time_text
from dcgrid_env.apps.hosting.hosting import SNAPSHOT, UNCONTROLLED, Capacities
from dcgrid_env.apps.hosting.load_hours import hours_text, windows_text
from dcgrid_env.apps.hosting.site_search import BusCapacity
from dcgrid_env.apps.hosting.sites_together import Together
from dcgrid_env.core.text_table import Table

COLUMNS = tuple(field.name for field in dataclasses.fields(BusCapacity))
"""Columns of the CSV, with one row for each controller and bus; sizes in a cell are separated by semicolons."""
_SHOWN = 12
"""Maximum number of branches or buses that a note names; results.json contains all."""
_NUMBERS = ("capacity_mw", "delay_mean_s", "delay_p95_s", "unserved_pct", "outside_pct", "margin")
_NUMBERS += ("most_windows_mw", "half_windows_mw")
NO_ANSWER = "no answer"
"""Controller of the CSV's rows of buses that are not candidates, whose limit is the reason and whose size is empty."""
_CONFIDENCE = 0.95
_LISTS = ("smaller_fails_mw", "larger_carries_mw")


def capacity_csv(capacities: Capacities) -> str:
    """Return all results, those of the snapshot first, and the reasons for buses without an answer."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(map(_cells, _all(capacities)))
    for bus, reason in capacities.study.left_out().items():
        writer.writerow({"controller": NO_ANSWER, "bus": bus, "limit": reason})
    return text.getvalue()


def capacity_table(capacities: Capacities) -> Table:
    """Make a table with a row for each bus: capacity in a snapshot and under each controller, and the delay."""
    study = capacities.study
    number = len(capacities.windows)
    window = f"{number} window{'s' * (number != 1)} of {study.window_s:g} s, {study.load_words}"
    limits = f"{study.v_min_pu:g} to {study.v_max_pu:g} p.u."
    title = f"{study.scenario.feeder.name}: largest data centre at a bus, MW, within {limits} ({window})"
    header = ["bus", SNAPSHOT]
    for name in capacities.controllers:
        header += [name, "95 % of windows", "limit", "delay mean s", "p95 s", "unserved %"]
    rows = []
    for i, bus in enumerate(capacities.buses):
        row = [bus, _mw(capacities.snapshot[i])]
        for name in capacities.controllers:
            capacity = capacities.by_controller[name][i]
            row += [
                _mw(capacity), f"{capacity.most_windows_mw:.3g}", capacity.limit or "none found",
                f"{capacity.delay_mean_s:.2f}", f"{capacity.delay_p95_s:.0f}",
                f"{capacity.unserved_pct:.1f}",
            ]  # fmt: skip
        rows.append(tuple(row))
    return Table(title, tuple(header), tuple(rows), tuple(_notes(capacities)))


def outages_table(capacities: Capacities, by_outage: Mapping[str, Capacities]) -> Table:
    """Make a table with the least capacity of each bus over single outages, and the outage that it has then."""
    header, rows = ["bus"], [[bus] for bus in capacities.buses]
    for name in capacities.controllers:
        header += [name, "with an outage", "outage"]
        for i, row in enumerate(rows):
            least = min(by_outage, key=lambda outage: by_outage[outage].by_controller[name][i].capacity_mw)
            row += [_mw(capacities.by_controller[name][i]), _mw(by_outage[least].by_controller[name][i]), least]
    title = f"{capacities.study.scenario.feeder.name}: capacity with one element out of service, MW"
    return Table(title, tuple(header), tuple(map(tuple, rows)), (f"Outages: {', '.join(by_outage)}.",))


def outages_csv(by_outage: Mapping[str, Capacities]) -> str:
    """Return all results with outages: the columns of ``capacity_csv`` and the outage."""
    text = io.StringIO()
    writer = csv.DictWriter(text, ("outage", *COLUMNS), lineterminator="\n")
    writer.writeheader()
    for outage, capacities in by_outage.items():
        writer.writerows({"outage": outage} | _cells(capacity) for capacity in _all(capacities))
    return text.getvalue()


def together_table(results: Sequence[Together]) -> Table:
    """Make a table of sites at once: a row for each bus, and their sum."""
    first = results[0]
    rows = [
        (bus, *(cell for one in results for cell in (f"{one.mw[i]:g}", one.limits[i] or "none found")))
        for i, bus in enumerate(first.buses)
    ]
    rows.append(("sum", *(cell for one in results for cell in (f"{one.sum_mw:g}", ""))))
    header = ("bus", *(cell for one in results for cell in (one.controller, "limit")))
    return Table(f"Sites at once, rule {first.rule}, MW", header, tuple(rows))


def record(capacities: Capacities) -> dict[str, Any]:
    """Return the study and its results as JSON values."""
    study, ratings = capacities.study, capacities.study.coverage
    study_fields = {
        field.name: getattr(study, field.name) for field in dataclasses.fields(study) if field.name != "scenario"
    }
    return {
        "study": study_fields
        | {
            "feeder": study.scenario.feeder.name,
            "scenario": study.scenario.name,
            "scenario_hash": scenario_hash(study.scenario),
            "split": study.scenario.split,
            "hours_considered": capacities.windows.considered,
            "worst_hours": {
                time_text(study.scenario, capacities.windows.hours[i]): reason
                for i, reason in enumerate(capacities.windows.reasons)
                if reason and capacities.windows.hours is not None
            },
            "trace": study.scenario.workload.trace if isinstance(study.scenario.workload.trace, str) else "recordings",
            "trace_scale": study.scenario.workload.trace_scale,
            "tolerance_mw": study.step_mw,
            "max_mw": study.largest_mw,
            "buses": list(capacities.buses),
            "full_load_s": list(study.full_load_s),
        },
        "ratings": ratings._asdict(),
        "overloaded_without_site": list(capacities.overloaded),
        "without_answer": study.left_out(),
        "notes": list(capacities.notes),
        "capacities": [dataclasses.asdict(capacity) for capacity in _all(capacities)],
    }


def _all(capacities: Capacities) -> Iterator[BusCapacity]:
    yield from capacities.snapshot
    for name in capacities.controllers:
        yield from capacities.by_controller[name]


def unseen_pct(samples: int) -> float:
    """Upper bound on the share of windows that break limits if none of so many does, % (Clopper and Pearson, 1934)."""
    return 100.0 * (1.0 - (1.0 - _CONFIDENCE) ** (1.0 / samples))


def _lowered(capacities: Capacities) -> Iterator[str]:
    """A warning for each controller that lowers the capacity of buses against no control."""
    if UNCONTROLLED not in capacities.by_controller:
        return
    uncontrolled = capacities.by_controller[UNCONTROLLED]
    for name in capacities.controllers:
        pairs = zip(uncontrolled, capacities.by_controller[name], strict=True)
        buses = [before.bus for before, after in pairs if after.capacity_mw < before.capacity_mw]
        if buses:
            yield f"{name} lowers the capacity of {_buses(buses)} against no control: {first_few(buses)}."


def _cells(capacity: BusCapacity) -> dict[str, str]:
    """A result as the cells of a row."""
    row = dataclasses.asdict(capacity)
    row |= {name: repr(row[name]) for name in _NUMBERS} | {"at_most": str(row["at_most"]).lower()}
    return row | {name: ";".join(map(repr, row[name])) for name in _LISTS}


def first_few(names: Sequence[str]) -> str:
    """Return the first of some names, and how many more there are."""
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return f"{', '.join(names[:_SHOWN])}{more}" if names else "none"


def _buses(names: Sequence[str]) -> str:
    """Number of buses in words."""
    return f"{len(names)} bus{'es' * (len(names) > 1)}"


def _mw(capacity: BusCapacity) -> str:
    """Format the size, with a mark if it is the largest that was tried or if sizes of the scan contradict it."""
    more = ">=" if capacity.at_most else ""
    return f"{more}{capacity.capacity_mw:g}{'*' * bool(capacity.smaller_fails_mw or capacity.larger_carries_mw)}"


def _snapshot_text(capacities: Capacities) -> str:
    """Describe the power flow of the snapshot, and what it bounds."""
    study, hours = capacities.study, capacities.windows.considered
    over = f"the least over a power flow of each of {hours_text(study, hours)}"
    flow = over if hours else "one power flow at nominal load"
    bound = "" if study.allowed_pct else "; without control, the result is at most the snapshot"
    return f"{flow}, without control and with all sites at their rating{bound}"


def _notes(capacities: Capacities) -> Iterator[str]:
    study = capacities.study
    allowed = (
        "may not be broken" if not study.allowed_pct else f"may be broken in {study.allowed_pct:g} % of the seconds"
    )
    yield (
        f"Snapshot: {_snapshot_text(capacities)}. Sizes are multiples of {study.step_mw:g} MW up to "
        f"{study.largest_mw:g}; >= where the largest still fits. Limits count from {study.settle_s:g} s into a window "
        f"on, and {allowed}."
    )
    yield windows_text(study, capacities.windows)
    yield (
        f'"95 % of windows" is the size that as many of the {study.samples} spread windows alone would carry, and so '
        "about what the bus carries in 95 % of the hours; those at the worst hours do not count in it. If none of "
        f"{study.samples} breaks a limit, less than {unseen_pct(study.samples):.2g} % of other windows do, with 95 % "
        "confidence."
    )
    yield from _lowered(capacities)
    begin_s, end_s = study.full_load_s
    yield f"In every window all sites are asked for their rating from {begin_s:g} to {end_s:g} s."
    yield f"R{str(study.coverage)[1:]}."
    if capacities.overloaded:
        yield (
            f"Overloaded without any site: {first_few(capacities.overloaded)}. No site fits behind these; at other "
            "buses they do not count."
        )
    by_reason: dict[str, list[str]] = {}
    for bus, reason in study.left_out().items():
        by_reason.setdefault(reason, []).append(bus)
    for reason, buses in by_reason.items():
        yield f"No answer for {_buses(buses)}, {reason}: {first_few(buses)}."
    for name in capacities.controllers:
        broken = [c for c in capacities.by_controller[name] if not c.capacity_mw and c.margin < 0.0]
        if len(broken) == len(capacities.buses):
            remedy = "another source_voltage_pu or other limits may help."
            yield f"{name}: limits are broken without any site: {broken[0].limit}; {remedy}"
    for capacity in _all(capacities):
        if capacity.smaller_fails_mw:
            sizes = ", ".join(f"{mw:g}" for mw in capacity.smaller_fails_mw)
            yield f"* {capacity.controller}, bus {capacity.bus}: smaller sites of {sizes} MW break limits"
        if capacity.larger_carries_mw:
            sizes = ", ".join(f"{mw:g}" for mw in capacity.larger_carries_mw)
            yield f"* {capacity.controller}, bus {capacity.bus}: larger sites of {sizes} MW keep within them"
    yield from capacities.notes
