"""The report of a connection study: one HTML file without external resources, also for print."""

from __future__ import annotations

import dataclasses
import hashlib
import html
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from dcgrid_env import Feeder, Scenario, profile_coverage, scenario_hash
from dcgrid_env.apps.hosting.capacity_maps import capacity_maps
from dcgrid_env.apps.hosting.capacity_output import capacity_table, first_few, record, unseen_pct
from dcgrid_env.apps.hosting.connection_study.checklists import checklists, other_means
from dcgrid_env.apps.hosting.connection_study.outage_section import capacities_with, outages_section
from dcgrid_env.apps.hosting.connection_study.section import Section, sentences, under
from dcgrid_env.apps.hosting.connection_study.sections import BUILDERS
from dcgrid_env.apps.hosting.connection_study.study_job import Job
from dcgrid_env.apps.hosting.hosting import Capacities
from dcgrid_env.apps.hosting.load_hours import windows_text
from dcgrid_env.baselines.carried import carried
from dcgrid_env.core.html_page import image, png
from dcgrid_env.core.html_page import page as html_page
from dcgrid_env.core.text_table import Table
from dcgrid_env.core.versions import meta
from dcgrid_env.core.work.unit import Place, Unit, shared
from dcgrid_env.grid import AnyFeeder

ORDER = (
    "base-case", "capacity", "worst-window", "outages", "several-sites", "day", "year", "ride-through", "fluctuation",
    "sensitivity",
)  # fmt: skip
"""Order of the computed sections in the report."""
_JOB = "job"
"""Name of the shared value."""
_STYLE = """
body { font-size: 16px } h3 { font-size: 1rem; margin: 1.2rem 0 .2rem; break-after: avoid } nav a { line-height: 2 }
th, td { padding: .25rem .8rem .25rem 0; text-align: left; white-space: nowrap } tbody th { font-weight: normal }
thead th { font-weight: 600; white-space: normal }
#checklists :is(td, th), #not-checked :is(td, th), #inputs td { white-space: normal; min-width: 7rem }
#inputs td { overflow-wrap: anywhere } figure { margin: 1rem 0; overflow-x: auto }
figcaption, .note { color: #444; font-size: .9rem }
.answer { border-left: 5px solid #0072B2; padding: .2rem 1rem; background: #f4f8fb }
@media screen and (max-width: 700px) { img { max-width: none; width: 44rem } ul { padding-left: 1.1rem } }
@media print { body { max-width: none; padding: 0; font-size: 10pt } nav { display: none } h2 { break-after: avoid }
  tr, figure { break-inside: avoid } .wide, figure { overflow: visible } table { font-size: .8rem }
  th, td { white-space: normal; padding-right: .5rem } }
"""


def built(job: Job, place: Place, on_section: Callable[[], None]) -> tuple[dict[str, Section], dict[str, Capacities]]:
    """Compute the sections that are not left out and the capacities with outages, as units of work.

    Parameters
    ----------
    job
        The request.
    place
        Where the units run; the results do not depend on it.
    on_section
        Called after each unit, for progress.

    Returns
    -------
    tuple[dict[str, Section], dict[str, Capacities]]
        Sections by name, and capacities of the requested bus by outage.

    Raises
    ------
    LostUnits
        For sections or outages without a result.
    """
    units: list[Unit[Any, Any]] = [
        *(Unit(f"section {name}", _build, name) for name in asked_sections(job)),
        *(Unit(f"outage {name}", _without, (name, scenario)) for name, scenario in job.outages.items()),
    ]
    values = {_JOB: dataclasses.replace(job, outages={})} | carried(place, (), job.request.controllers)
    sections: dict[str, Section] = {}
    by_outage: dict[str, Capacities] = {}
    for _, (name, result) in place.results(units, values, how_to_go_on=""):
        if isinstance(result, Section):
            sections[name] = result
        else:
            by_outage[name] = result
        on_section()
    return sections, by_outage


def asked_sections(job: Job) -> list[str]:
    """The sections of ``BUILDERS`` that a request asks for; ``year`` needs load profiles."""
    left = set(job.request.leave_out)
    if job.request.several_sites is None:
        left.add("several-sites")
    if job.study.scenario.load_profiles.file is None:
        left.add("year")
    return [name for name in BUILDERS if name not in left]


def _build(name: str) -> tuple[str, Section]:
    return name, BUILDERS[name](shared(_JOB))


def _without(outage: tuple[str, Scenario]) -> tuple[str, Capacities]:
    name, scenario = outage
    return name, capacities_with(shared(_JOB), scenario)


def sections_of(
    job: Job, capacities: Capacities | None, file: Path, place: Place, on_section: Callable[[], None]
) -> list[Section]:
    """Make the sections of the report in its order; arguments as for ``page`` and ``built``."""
    by_name, by_outage = built(job, place, on_section)
    if capacities is not None:
        by_name["capacity"] = _capacity(job, capacities)
        if job.outages:
            in_order = {name: by_outage[name] for name in job.outages}
            by_name["outages"] = outages_section(job, capacities, in_order)
    sections = [by_name[name] for name in ORDER if name in by_name]
    sections.append(_not_checked(job, capacities))
    if "checklists" not in job.request.leave_out:
        text = "What follows is no legal advice. Sources are secondary; check each line against the final text."
        sections.append(
            Section("checklists", "Checklists for large loads", "", (text,), checklists(job.request.leave_out))
        )
    sections.append(_inputs(job, file, meta()))
    return sections


def answers(job: Job, capacities: Capacities | None) -> list[str]:
    """The answer for the requested size under each controller, in sentences, and how sure it is."""
    if capacities is None:
        return ["The capacity was left out of this study, so it gives no answer on the size."]
    request, said = job.request, []
    for name in capacities.controllers:
        (capacity,) = (c for c in capacities.by_controller[name] if c.bus == request.bus)
        fits = request.mw <= capacity.capacity_mw + 1e-9
        size = f"{'at least ' if capacity.at_most else ''}{capacity.capacity_mw:g} MW"
        why = "" if capacity.at_most else f" The next size breaks: {capacity.limit}."
        if not capacity.capacity_mw and capacity.margin < 0.0:
            why = f" Limits are broken without any site: {capacity.limit}."
        waits = capacity.delay_mean_s >= 0.005
        delay = f" Work waits {capacity.delay_mean_s:.2f} s on average at that size." if waits else ""
        verdict = "fits" if fits else "does not fit"
        request_text = f"{request.mw:g} MW at bus {request.bus} {verdict}"
        said.append(sentences((f"{under(name)}, {request_text}: the bus carries {size}",)) + why + delay)
    return said


def confidence(job: Job, capacities: Capacities | None) -> str:
    """State the number of windows, the bound that it gives and what was not checked, in sentences."""
    study, coverage, sizes = job.study, job.study.coverage, ""
    if capacities is not None:
        sizes = (
            f"These sizes rest on {len(capacities.windows)} windows of {study.window_s:g} s. "
            f"{windows_text(study, capacities.windows)} If none of {study.samples} spread windows breaks a limit, "
            f"less than {unseen_pct(study.samples):.2g} % of other windows do, with 95 % confidence. "
        )
    others = "; the others were not checked" if coverage.not_checked else ""
    return (
        f"{sizes}Ratings are known for {coverage.known} of {coverage.of} elements{others}. Faults, protection, "
        "harmonics, stability and the transmission grid need other studies."
    )


def page(job: Job, capacities: Capacities | None, sections: Sequence[Section]) -> str:
    """The report as HTML."""
    request, study = job.request, job.study
    links = " ".join(f'<a href="#{s.name}">{html.escape(s.title)}</a>' for s in sections)
    said = "".join(f"<p><b>{html.escape(text)}</b></p>" for text in answers(job, capacities))
    more = "".join(
        f'<li><a href="#{s.name}">{html.escape(s.title)}</a>: {html.escape(s.answer)}</li>'
        for s in sections
        if s.answer and s.name != "capacity"
    )
    request_text = (
        f"Request: a data centre of {request.mw:g} MW at bus {request.bus} of feeder {study.scenario.feeder.name}. "
        f"Limits: {study.v_min_pu:g} to {study.v_max_pu:g} p.u. and {study.loading_max_pct:g} % of known ratings."
    )
    parts = [
        f"<p>{html.escape(request_text)}</p><p>{html.escape(sentences((job.source,)))}</p>",
        f"<div class=answer>{said}<p>{html.escape(confidence(job, capacities))}</p><ul>{more}</ul></div>",
        f"<nav>{links}</nav>",
        *(_section(section) for section in sections),
        f"<p>Reproduce: <code>{html.escape(meta()['command'])}</code></p>",
    ]
    return html_page(request.title, "".join(parts), _STYLE)


def report_json(job: Job, capacities: Capacities | None, sections: Sequence[Section]) -> dict[str, Any]:
    """The report's tables and answers as JSON values."""
    return {
        "meta": meta(),
        "source_voltage": job.source,
        "answers": answers(job, capacities),
        "confidence": confidence(job, capacities),
        "capacity": None if capacities is None else record(capacities),
        "sections": {
            section.name: {
                "answer": section.answer,
                "text": list(section.paragraphs),
                "tables": [
                    {"title": t.title, "header": t.header, "rows": t.rows, "notes": t.notes} for t in section.tables
                ],
            }
            for section in sections
        },
    }


def _capacity(job: Job, capacities: Capacities) -> Section:
    picture = ("The largest data centre at each bus, MW", png(capacity_maps(capacities)))
    allowed_pct, rule = job.study.allowed_pct, "no window breaks a limit, and without control no hour in a power flow"
    if allowed_pct:
        rule = f"limits are broken in at most {allowed_pct:g} % of the seconds of all windows"
    text = (
        f"One data centre at one bus at a time. A size fits if {rule}. Every window has a step of the "
        "site to its full rating."
    )
    whole, tables = capacity_table(capacities), []
    for name in capacities.controllers:  # one for each, which is narrower than all in one
        table = capacity_table(dataclasses.replace(capacities, controllers=(name,)))
        rows = [(f"{row[0]} (requested)" if row[0] == job.request.bus else row[0], *row[1:]) for row in table.rows]
        rows.sort(key=lambda row: not row[0].endswith(" (requested)"))
        title = f"Largest data centre at a bus under {name}, MW"
        tables.append(
            Table(title, table.header, tuple(rows), whole.notes if name == capacities.controllers[-1] else ())
        )
    answer = " ".join(answers(job, capacities))
    return Section("capacity", "Capacity of the buses", answer, (text,), tuple(tables), (picture,))


def _not_checked(job: Job, capacities: Capacities | None) -> Section:
    coverage = job.study.coverage
    texts = [f"Elements without a known rating, which were not checked: {first_few(coverage.not_checked)}."]
    if capacities is not None:
        left = [f"{bus} ({why})" for bus, why in job.study.left_out().items()]
        untried = job.study.scenario.feeder.n_bus - 1 - len(capacities.buses)
        without = (
            first_few(left) if left else f"{untried}, which were not among the buses to try" if untried else "none"
        )
        texts.append(f"Buses without an answer: {without}.")
        more = " and the reasons in capacity.without_answer" * bool(left)
        texts.append(f"report.json lists all elements in capacity.ratings{more}.")
        if capacities.overloaded:
            texts.append(
                f"Overloaded without the site: {first_few(capacities.overloaded)}. They do not count elsewhere."
            )
    if job.request.leave_out:
        texts.append(f"Sections left out on request: {', '.join(job.request.leave_out)}.")
    if not job.outages:
        texts.append("No outages were asked for (outages in the study's file).")
    missing = f"{len(coverage.not_checked)} of {coverage.of} elements have no known rating, and the"
    answer = f"{missing if coverage.not_checked else 'The'} studies in the table must be done by other means."
    return Section("not-checked", "What was not checked", answer, tuple(texts), (other_means(coverage),))


def _inputs(job: Job, file: Path, about: dict[str, Any]) -> Section:
    study, scenario = job.study, job.study.scenario
    profiles = scenario.load_profiles.file
    files = [file, *_feeder_files(scenario.feeder)]
    files += [Path(profiles.asked_by)] if profiles is not None and profiles.asked_by is not None else []
    recordings = () if isinstance(scenario.workload.trace, str) else scenario.workload.trace
    files += [Path(trace.asked_by) for trace in recordings if trace.asked_by and Path(trace.asked_by).is_file()]
    hashes = tuple((path.name, hashlib.sha256(path.read_bytes()).hexdigest()) for path in files)
    sited = job.scenario(job.request.mw)
    centres, trace = sited.datacenters, scenario.workload.trace
    trace = trace if isinstance(trace, str) else f"recordings {', '.join(one.name for one in recordings)}"
    assumptions = (
        ("feeder", scenario.feeder.name),
        (
            "connection",
            f"{job.request.mw:g} MW at bus {job.request.bus}, {_base_kv(scenario.feeder, job.request.bus):g} kV",
        ),
        ("scenario hash", scenario_hash(scenario)),
        ("source voltage", job.source.removeprefix("source at ")),
        ("limits", f"{study.v_min_pu:g} to {study.v_max_pu:g} p.u., {study.loading_max_pct:g} % of known ratings"),
        ("windows", f"{study.samples} of {study.window_s:g} s, {study.load_words}, and those at the worst hours"),
        ("load profiles", "none" if profiles is None else str(profile_coverage(scenario))),
        ("other loads", f"noise of {100.0 * scenario.background.load_sigma:g} %"),
        (
            "site",
            f"converter of {centres.s_rated_share:g} x rating, clock {centres.f_min_mhz:g} to {centres.f_max_mhz:g} "
            f"MHz, clock law {type(centres.clock_law).__name__}, idle share {centres.idle_share}, "
            f"trace {trace}",
        ),
        ("ride-through", f"curve {job.request.ride_through.curve}, sags {job.request.ride_through.sags}"),
        ("controllers", ", ".join(job.request.controllers)),
        ("versions", ", ".join(f"{name} {version}" for name, version in about["versions"].items() if version)),
    )
    tables = (Table("Files", ("file", "SHA-256"), hashes), Table("Assumptions", ("what", "value"), assumptions))
    return Section("inputs", "Inputs and assumptions", "", (), tables)


def _base_kv(feeder: Any, bus: str) -> float:
    """Nominal voltage of a bus, line to line, kV."""
    position = feeder.index(bus)
    if isinstance(feeder, Feeder):
        return feeder.base_kv if feeder.bus_base_kv is None else float(feeder.bus_base_kv[position])
    return float(f"{math.sqrt(3.0) * feeder.base_kv_ln[position]:.5g}")


def _feeder_files(feeder: AnyFeeder) -> list[Path]:
    """The files of a feeder that was read from a folder."""
    return [] if feeder.folder is None else sorted(path for path in feeder.folder.iterdir() if path.is_file())


def _section(section: Section) -> str:
    answer = f"<p><b>{html.escape(section.answer)}</b></p>" if section.answer else ""
    texts = answer + "".join(f"<p>{html.escape(text)}</p>" for text in section.paragraphs)
    tables = "".join(f"<h3>{html.escape(table.title)}</h3>{table.html()}" for table in section.tables)
    pictures = "".join(
        f"<figure>{image(data, text)}<figcaption>{html.escape(text)}</figcaption></figure>"
        for text, data in section.pictures
    )
    return f'<section id="{section.name}"><h2>{html.escape(section.title)}</h2>{texts}{tables}{pictures}</section>'
