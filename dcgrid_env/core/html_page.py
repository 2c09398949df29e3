"""HTML reports: one file each, without scripts and external resources."""

from __future__ import annotations

import base64
import html
import io
from typing import Any

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; margin: 1.5rem auto; max-width: 1180px; padding: 0 1rem }
h1 { font-size: 1.5rem; overflow-wrap: anywhere }
h2 { font-size: 1.2rem; margin-top: 2rem; border-top: 1px solid #ccc; padding-top: .8rem }
p { margin: .4rem 0; overflow-wrap: anywhere } nav a { margin-right: .9rem; white-space: nowrap }
.wide { overflow-x: auto } table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums }
th, td { padding: .25rem .6rem; text-align: right; vertical-align: top; border-bottom: 1px solid #e4e4e4 }
thead th { border-bottom: 2px solid #888; vertical-align: bottom } tbody th, th:first-child { text-align: left }
img { max-width: 100%; height: auto } .note { color: #444; font-size: 13px }
code { font: 13px/1.4 ui-monospace, monospace; overflow-wrap: anywhere }
pre { background: #f4f4f4; padding: .6rem; white-space: pre-wrap; overflow-wrap: anywhere }
""".strip()


def page(title: str, body: str, style: str = "") -> str:
    """Return an HTML file.

    Parameters
    ----------
    title
        Title of the browser tab, and the first heading. It is escaped.
    body
        Content below the heading, as HTML.
    style
        Further rules of CSS, which take precedence over ``STYLE``.
    """
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>\n{STYLE}\n{style}</style></head><body>\n"
        f"<h1>{html.escape(title)}</h1>\n{body}\n</body></html>\n"
    )


def image(picture: bytes, text: str) -> str:
    """Return a PNG file as an HTML image, with its description for readers who do not see it."""
    return f'<img alt="{html.escape(text)}" src="data:image/png;base64,{base64.b64encode(picture).decode()}">'


def png(figure: Any, dpi: float = 110.0) -> bytes:
    """Return a Matplotlib figure as a PNG file."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=dpi)
    return file.getvalue()
