"""The report of a connection study: one HTML file without external resources, also for print."""

from __future__ import annotations

import base64
import hashlib
import html
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from dcgrid_env import profile_coverage, scenario_hash
from dcgrid_env.baselines.benchmark.benchmark_tables import Table
from dcgrid_env.baselines.connection_study.checklists import ERCOT, NERC
from dcgrid_env.baselines.connection_study.section import Section, png
from dcgrid_env.baselines.connection_study.sections import BUILDERS, Job, section_names
from dcgrid_env.baselines.hosting_capacity.capacity_maps import capacity_maps
from dcgrid_env.baselines.hosting_capacity.capacity_output import capacity_table, first_of, record
from dcgrid_env.baselines.hosting_capacity.hosting import Capacities
from dcgrid_env.core.versions import meta
from dcgrid_env.grid import AnyFeeder

NOT_MODELLED = (
    "Short-circuit currents, protection coordination, harmonics, frequency, transient stability and the transmission "
    "grid are not in the model. Loads have no dynamics within a second."
)
_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#1a1a1a;max-width:72rem;margin:0 auto;padding:1rem}
h1{font-size:1.7rem;margin:.5rem 0}h2{font-size:1.25rem;border-bottom:1px solid #ccc;margin-top:2rem}
nav a{margin-right:.8rem;white-space:nowrap}.wide{overflow-x:auto}table{border-collapse:collapse;font-size:.85rem}
th,td{padding:.25rem .6rem;text-align:right;border-bottom:1px solid #e3e3e3;vertical-align:top}
th:first-child,td:first-child{text-align:left;font-weight:normal}thead th{border-bottom:2px solid #888;font-weight:600}
.text td{text-align:left}img{max-width:100%;height:auto}figcaption,.note{color:#444;font-size:.9rem}
.answer{border-left:5px solid #0072B2;padding:.2rem 1rem;background:#f4f8fb}code{overflow-wrap:anywhere}
caption{text-align:left;font-weight:600;padding:.6rem 0 .2rem}
@media print{body{max-width:none;padding:0;font-size:10pt}nav{display:none}h2{break-after:avoid}
table,figure{break-inside:avoid}.wide{overflow:visible}}
"""


def sections_of(job: Job, found: Capacities | None, on_section: Callable[[], None]) -> list[Section]:
    """Compute the sections of the report that are not left out; ``on_section`` is called after each."""
    made = []
    for name in section_names(job):
        made.append(BUILDERS[name](job))
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
    title = html.escape(request.title)
    links = " ".join(f'<a href="#{s.name}">{html.escape(s.title)}</a>' for s in sections)
    said = "".join(f"<p>{html.escape(text)}</p>" for text in answers(job, found))
    parts = [
        f"<h1>{title}</h1>",
        f"<p>{html.escape(f'Feeder {job.study.scenario.feeder.name}, {request.mw:g} MW at bus {request.bus}')}</p>",
        f"<nav>{links} <a href='#inputs'>Inputs</a></nav>",
        f"<div class=answer>{said}</div>",
        *(_section(section) for section in sections),
        _section(_inputs(job, file, about)),
        f"<p>Reproduce: <code>{html.escape(about['command'])}</code></p>",
    ]
    head = f"<meta charset=utf-8><meta name=viewport content='width=device-width'><title>{title}</title>"
    return (
        f"<!doctype html><html lang=en><head>{head}<style>{_STYLE}</style></head><body>{''.join(parts)}</body></html>\n"
    )


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
    coverage = job.study.coverage
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
    profiles = scenario.load_profiles.file
    files = [file, *_feeder_files(scenario.feeder)]
    files += [Path(profiles.asked_by)] if profiles is not None and profiles.asked_by is not None else []
    hashes = tuple((path.name, hashlib.sha256(path.read_bytes()).hexdigest()) for path in files)
    assumptions = (
        ("feeder", scenario.feeder.name),
        ("scenario hash", scenario_hash(scenario)),
        ("source voltage", f"{scenario.source_voltage_pu:.6g} p.u."),
        ("limits", f"{study.v_min_pu:g} to {study.v_max_pu:g} p.u., {study.loading_max_pct:g} % of known ratings"),
        ("windows", f"{study.samples} of {study.window_s:g} s, {study.load} load, split {scenario.split}"),
        ("load profiles", "none" if profiles is None else str(profile_coverage(scenario))),
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
        f'<figure><img alt="{html.escape(text, quote=True)}" src="data:image/png;base64,'
        f'{base64.b64encode(data).decode()}"><figcaption>{html.escape(text)}</figcaption></figure>'
        for text, data in section.pictures
    )
    return f'<section id="{section.name}"><h2>{html.escape(section.title)}</h2>{texts}{tables}{pictures}</section>'
