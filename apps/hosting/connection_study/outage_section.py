"""Section on the capacity of the requested bus with one element out of service (N-1)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from dcgrid_env import Scenario
from dcgrid_env.apps.hosting.connection_study.section import Section, sentences, under
from dcgrid_env.apps.hosting.connection_study.study_job import Job
from dcgrid_env.apps.hosting.hosting import Capacities, hosting_capacity
from dcgrid_env.core.text_table import Table


def capacities_with(job: Job, scenario: Scenario) -> Capacities:
    """Find the capacity of the requested bus under each controller on another feeder, one with an outage."""
    study = job.study
    changed = dataclasses.replace(
        study.with_outage(scenario), buses=(job.request.bus,), tolerance_mw=study.step_mw, max_mw=study.largest_mw
    )
    return hosting_capacity(changed, job.request.controllers)


def outages_section(job: Job, whole: Capacities, by_outage: Mapping[str, Capacities]) -> Section:
    """Compare the capacity of the requested bus in service and with each outage.

    Parameters
    ----------
    job
        The request.
    whole
        Capacity of the bus with all elements in service.
    by_outage
        Capacity of the bus by outage.
    """
    request = job.request
    header = ["out of service"]
    rows = [["none"], *([name] for name in by_outage)]
    said = []
    for name in whole.controllers:
        header += [f"{name}, MW", f"{request.mw:g} MW fits", "limit"]
        mw = {}
        for row, capacities in zip(rows, (whole, *by_outage.values()), strict=True):
            (capacity,) = (c for c in capacities.by_controller[name] if c.bus == request.bus)
            mw[row[0]] = capacity.capacity_mw
            more = ">=" if capacity.at_most else ""
            fits = "yes" if request.mw <= capacity.capacity_mw + 1e-9 else "no"
            row += [f"{more}{capacity.capacity_mw:g}", fits, capacity.limit or "none found"]
        worst = min(by_outage, key=lambda outage, mw=mw: mw[outage])
        verdict = "still fits" if request.mw <= mw[worst] + 1e-9 else "does not fit"
        said.append(
            f"{under(name)}, the bus carries {mw['none']:g} MW with all elements in service and {mw[worst]:g} MW in "
            f"the worst outage ({worst}), in which {request.mw:g} MW {verdict}"
        )
    text = (
        "Each row repeats the search for the requested bus with one element out of service or with other switch "
        "positions. A capacitor bank is off. A bank of regulators stays at its neutral taps. The capacity is 0 if an "
        f"outage alone breaks limits. With an outage, {job.study.outage_rating or job.study.rating} ratings apply."
    )
    table = Table(f"Capacity of bus {request.bus} with outages", tuple(header), tuple(map(tuple, rows)))
    return Section("outages", "Outages", sentences(said), (text,), (table,))
