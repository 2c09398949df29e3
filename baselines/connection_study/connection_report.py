"""The report of a connection study: one HTML file without external resources, also for print."""

from __future__ import annotations

import hashlib
import html
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from dcgrid_env import rating_coverage, scenario_hash
from dcgrid_env.baselines.benchmark.benchmark_tables import Table
from dcgrid_env.baselines.connection_study.checklists import ERCOT, NERC
from dcgrid_env.baselines.connection_study.section import Section
from dcgrid_env.baselines.connection_study.sections import BUILDERS, Job
from dcgrid_env.baselines.hosting_capacity.capacity_maps import capacity_maps
from dcgrid_env.baselines.hosting_capacity.capacity_output import capacity_table, first_of, record
from dcgrid_env.baselines.hosting_capacity.hosting import Capacities
from dcgrid_env.core.html_page import image, png
from dcgrid_env.core.html_page import page as html_page
from dcgrid_env.core.versions import meta
from dcgrid_env.grid import AnyFeeder

NOT_MODELLED = (
    "Short-circuit currents, protection coordination, harmonics, frequency, transient stability and the transmission "
    "grid are not in the model. Loads have no dynamics within a second."
)
_STYLE = """
body { font-size: 16px } th:first-child, td:first-child { text-align: left; font-weight: normal }
thead th { font-weight: 600 } figcaption, .note { color: #444; font-size: .9rem } figure { margin: 1rem 0 }
.answer { border-left: 5px solid #0072B2; padding: .2rem 1rem; background: #f4f8fb }
@media print { body { max-width: none; padding: 0; font-size: 10pt } nav { display: none } h2 { break-after: avoid }
  table, figure { break-inside: avoid } .wide { overflow: visible } }
"""


def sections_of(job: Job, found: Capacities | None, on_section: Callable[[], None]) -> list[Section]:
    """Compute the sections of the report that are not left out; ``on_section`` is called after each."""
    made = []
    for name, build in BUILDERS.items():
        if name in job.request.leave_out:
            continue
        made.append(build(job))
        if name == "base-case" and found is not None:
            made.append(_capacity(found))
        on_section()
    if found is not None and "base-case" in job.request.leave_out:
        made.insert(0, _capacity(found))
    made.append(_not_checked(job, found))
    if "checklists" not in job.request.leave_out:
        text = "What follows is no legal advice. Sources are secondary; check each line against the final text."
        made.append(Section("checklists", "Checklists for large loads", (text,), (NERC, ERCOT)))
    return made


def answers(job: Job, found: Capacities | None) -> list[str]:
    """The answer for the requested size under each controller, in sentences."""
    if found is None:
        return ["The capacity was left out of this study, so it gives no answer on the size."]
    request, said = job.request, []
    for name in found.controllers:
        at = [c for c in found.by_controller[name] if c.bus == request.bus]
        if not at:
            continue
        (capacity,) = at
        fits = request.mw <= capacity.capacity_mw + 1e-9
        size = f"{'at least ' if capacity.at_most else ''}{capacity.capacity_mw:g} MW"
        why = "" if capacity.at_most else f" The next size breaks: {capacity.limit}."
        delay = f" Work waits {capacity.delay_mean_s:.2f} s on average at that size." if capacity.delay_mean_s else ""
        verdict = "fits" if fits else "does not fit"
        said.append(
            f"Under {name}, {request.mw:g} MW at bus {request.bus} {verdict}: the bus carries {size}.{why}{delay}"
        )
    return said


def page(job: Job, found: Capacities | None, sections: Sequence[Section], file: Path) -> str:
    """The report as HTML; ``file`` is the study's file."""
    request, about = job.request, meta()
    links = " ".join(f'<a href="#{s.name}">{html.escape(s.title)}</a>' for s in sections)
    said = "".join(f"<p>{html.escape(text)}</p>" for text in answers(job, found))
    parts = [
        f"<p>{html.escape(f'Feeder {job.study.scenario.feeder.name}, {request.mw:g} MW at bus {request.bus}')}</p>",
        f"<nav>{links} <a href='#inputs'>Inputs</a></nav>",
        f"<div class=answer>{said}</div>",
        *(_section(section) for section in sections),
        _section(_inputs(job, file, about)),
        f"<p>Reproduce: <code>{html.escape(about['command'])}</code></p>",
    ]
    return html_page(request.title, "".join(parts), _STYLE)


def plain(job: Job, found: Capacities | None, sections: Sequence[Section]) -> dict[str, Any]:
    """The report's tables and answers as JSON values."""
    return {
        "meta": meta(),
        "answers": answers(job, found),
        "capacity": None if found is None else record(found),
        "sections": {
            section.name: {
                "text": list(section.paragraphs),
                "tables": [{"title": t.title, "header": t.header, "rows": t.rows} for t in section.tables],
            }
            for section in sections
        },
    }


def _capacity(found: Capacities) -> Section:
    picture = ("The largest data centre at each bus, MW", png(capacity_maps(found)))
    text = (
        "One data centre at one bus at a time. A size fits if no window breaks a limit. Every window has a step of the "
        "site to its full rating."
    )
    return Section("capacity", "Capacity of the buses", (text,), (capacity_table(found),), (picture,))


def _not_checked(job: Job, found: Capacities | None) -> Section:
    coverage = rating_coverage(job.study.scenario.feeder)
    texts = [
        NOT_MODELLED,
        f"Elements without a known rating, which were not checked: {first_of(coverage.not_checked)}.",
    ]
    if found is not None and found.overloaded:
        texts.append(f"Overloaded without the site: {first_of(found.overloaded)}. They do not count elsewhere.")
    if "capacity" not in job.request.leave_out:
        left = job.study.left_out()
        texts.append(f"Buses without an answer: {first_of([f'{bus} ({why})' for bus, why in left.items()])}.")
    if job.request.leave_out:
        texts.append(f"Sections left out on request: {', '.join(job.request.leave_out)}.")
    return Section("not-checked", "What was not checked", tuple(texts))


def _inputs(job: Job, file: Path, about: dict[str, Any]) -> Section:
    study, scenario = job.study, job.study.scenario
    files = [file, *_feeder_files(scenario.feeder)]
    hashes = tuple((path.name, hashlib.sha256(path.read_bytes()).hexdigest()) for path in files)
    assumptions = (
        ("feeder", scenario.feeder.name),
        ("scenario hash", scenario_hash(scenario)),
        ("source voltage", f"{scenario.source_voltage_pu:.6g} p.u."),
        ("limits", f"{study.v_min_pu:g} to {study.v_max_pu:g} p.u., {study.loading_max_pct:g} % of known ratings"),
        ("windows", f"{study.samples} of {study.window_s:g} s, {study.load} load, split {scenario.split}"),
        ("other loads", f"noise of {100.0 * scenario.background.load_sigma:g} %"),
        ("site", f"clock law {scenario.datacenters.clock_law}, idle share {scenario.datacenters.idle_share}"),
        ("versions", ", ".join(f"{name} {version}" for name, version in about["versions"].items() if version)),
    )
    tables = (
        Table("Files", ("file", "SHA-256"), hashes),
        Table("Assumptions", ("what", "value"), assumptions),
    )
    return Section("inputs", "Inputs and assumptions", (), tables)


def _feeder_files(feeder: AnyFeeder) -> list[Path]:
    """The files of a feeder that was read from a folder."""
    return [] if feeder.folder is None else sorted(path for path in feeder.folder.iterdir() if path.is_file())


def _section(section: Section) -> str:
    texts = "".join(f"<p>{html.escape(text)}</p>" for text in section.paragraphs)
    tables = "".join(f"<p><b>{html.escape(table.title)}</b></p>{table.html()}" for table in section.tables)
    pictures = "".join(
        f"<figure>{image(data, text)}<figcaption>{html.escape(text)}</figcaption></figure>"
        for text, data in section.pictures
    )
    return f'<section id="{section.name}"><h2>{html.escape(section.title)}</h2>{texts}{tables}{pictures}</section>'
