"""The page import_report.html: one file without scripts that needs nothing else."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from pathlib import Path

from dcgrid_env.apps.importers.import_record import ImportRecord, effect_figures
from dcgrid_env.apps.importers.import_report import Finding, shown_names
from dcgrid_env.core.files import write_json, write_text
from dcgrid_env.core.html_page import page as html_page

JSON_FILE, HTML_FILE = "import_report.json", "import_report.html"
_STYLE = """
body { max-width: 1080px } table { font-size: 14px } thead th { white-space: nowrap }
th, td { padding: .3rem 1rem .3rem 0 } th.text, td.text { text-align: left }
th.number, td.number { white-space: nowrap } td.text { overflow-wrap: anywhere; min-width: 4.5rem }
.lost { color: #9a3412; font-weight: 600 } .fine { color: #166534; font-weight: 600 }
td:first-child { overflow-wrap: break-word } summary { cursor: pointer }
@media (max-width: 600px) { table { font-size: 12.5px } th, td { padding-right: .5rem } }
""".strip()


def write_report(record: ImportRecord, folder: Path) -> None:
    """Write the record as JSON and as a page."""
    write_json(folder / JSON_FILE, record.as_json())
    write_text(folder / HTML_FILE, page(record))


def page(record: ImportRecord) -> str:
    """The whole file; all names are escaped."""
    parts = [_result(record), _elements(record), *_losses(record), _ratings(record), _reproduction(record)]
    about = f"<p>{html.escape(record.source)}. {html.escape(record.size)}.</p>"
    return html_page(f"Import of {record.feeder}", "\n".join([about, *parts]), _STYLE)


def _result(record: ImportRecord) -> str:
    fine = record.comparisons[-1].is_close and not record.verdicts
    parts = [_p(text, "" if fine else "lost") for text in record.verdicts]
    if fine and not record.has_losses:
        parts.append(_p("Nothing is lost, and both power flows agree.", "fine"))
    parts += [_p(note) for note in record.notes]
    for one in record.comparisons:
        parts.append(_p(f"dcgrid compared with {one.solver}, {one.circuit}:" if one.largest else str(one)))
        rows = [(_text(near.node), f"{near.difference_pu:.1e}", f"{near.difference_v:.2g}") for near in one.largest]
        parts.append(_table(("node", "difference, p.u.", "V"), rows, numbers=(1, 2)) if rows else "")
    return "<h2>Voltages</h2>\n" + "\n".join(parts)


def _elements(record: ImportRecord) -> str:
    rows = [
        (_text(row.kind), str(len(row.names)), _names(row.shown, row.names), _outcome(row)) for row in record.findings
    ]
    return "<h2>Elements</h2>\n" + _table(("element", "number", "names", "outcome"), rows, numbers=(1,))


def _outcome(row: Finding) -> str:
    kind = " class=lost" if row.fate == "lost" else ""
    return f"<span{kind}>{_text(row.fate)}</span>: {_text(row.text)}"


def _names(shown: str, names: Sequence[str]) -> str:
    """The first names, with all of them behind a click if there are more."""
    every = ", ".join(names)
    if shown == every:
        return _text(shown)
    return f"<details><summary>{_text(shown)}</summary>{_text(every)}</details>"


def _losses(record: ImportRecord) -> Iterable[str]:
    if not record.has_losses:
        return
    yield "<h2>What the omitted elements change</h2>"
    if not record.effects:
        yield _p("The change in volts and kW is not known.")
        return
    yield _p(
        "Change of OpenDSS's power flow, controls off, when the omitted elements are disabled. A control that is "
        "omitted changes it only when it acts."
    )
    rows = [
        (_text(", ".join(one.kinds)), str(one.number), _text(one.node), *effect_figures(one)) for one in record.effects
    ]
    yield _table(("kind", "number", "node", "V", "p.u.", "source kW", "source kvar"), rows, numbers=(1, 3, 4, 5, 6))
    if not all(one.node for one in record.effects):
        yield _p("Not known: OpenDSS finds no solution without these elements.")


def _ratings(record: ImportRecord) -> str:
    rows = [
        (_text(row.kind), str(row.known), str(row.number), _names(shown_names(row.not_known), row.not_known))
        for row in record.ratings
    ]
    parts = ["<h2>Ratings</h2>", _p("Loading is not checked for branches whose rating is not known.")]
    return "\n".join([*parts, _table(("kind", "known", "of", "not known"), rows, numbers=(1, 2))])


def _reproduction(record: ImportRecord) -> str:
    parts = ["<h2>How to reproduce</h2>", f"<pre>{html.escape(record.command)}</pre>"]
    if record.files:
        parts.append(_table(("file", "SHA-256"), [(_text(name), digest) for name, digest in record.files]))
    parts.append(_p(", ".join(f"{name} {text or 'not installed'}" for name, text in record.versions.items())))
    return "\n".join(parts)


def _table(header: Sequence[str], rows: Iterable[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    """A table of cells that are HTML already."""
    kinds = ["number" if k in numbers else "text" for k in range(len(header))]
    head = "".join(f"<th class={kind}>{text}</th>" for kind, text in zip(kinds, header, strict=True))
    body = "".join(
        "<tr>" + "".join(f"<td class={kind}>{cell}</td>" for kind, cell in zip(kinds, row, strict=True)) + "</tr>"
        for row in rows
    )
    return f"<div class=wide><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"


def _text(text: str) -> str:
    return html.escape(text)


def _p(text: str, kind: str = "") -> str:
    attribute = f" class={kind}" if kind else ""
    return f"<p{attribute}>{_text(text)}</p>"
