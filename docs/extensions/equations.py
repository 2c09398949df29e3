"""Equations as SVG, made when the site is built: a page shows them without a script, a font or the network."""

from __future__ import annotations

import html
import re
from functools import cache
from typing import Any

import ziamath
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.math import get_node_equation_number

SIZE = 16.0
"""Pixels of an em while an equation is drawn; on the page it scales with the text."""
SIZES = re.compile(r'^<svg([^>]*?) width="([\d.]+)" height="([\d.]+)"')
ziamath.config.svg2 = False  # shapes within each equation: those that pages share by name would differ in size


@cache
def drawn(tex: str, inline: bool) -> str:
    """Return an equation as an SVG element in the text colour, aligned to the baseline, with its TeX as label."""
    equation = ziamath.Latex(tex, size=SIZE, inline=inline, color="currentColor")
    svg = equation.svg()
    found = SIZES.match(svg)
    if found is None:
        raise ValueError(f"equation {tex!r}: the drawing does not begin with its size: {svg[:80]!r}")
    width, height = (float(x) / SIZE for x in found.groups()[1:])
    drop = equation.getyofst() / SIZE if inline else 0.0
    style = f"width:{width:.3f}em;height:{height:.3f}em;vertical-align:{drop:.3f}em"
    label = html.escape(" ".join(tex.split()), quote=True)
    return f'<svg role="img" aria-label="{label}" class="equation" style="{style}"{found.group(1)}' + svg[found.end() :]


def visit_inline(translator: Any, node: nodes.math) -> None:
    """Write an equation within a line."""
    translator.body.append(drawn(node.astext(), True))
    raise nodes.SkipNode


def visit_block(translator: Any, node: nodes.math_block) -> None:
    """Write a displayed equation, with its number and anchor if it has a label."""
    translator.body.append(translator.starttag(node, "div", CLASS="equation"))
    translator.body.append(drawn(node.astext(), False))
    if node["number"]:
        translator.body.append(f'<span class="eqno">({get_node_equation_number(translator, node)})')
        translator.add_permalink_ref(node, "Link to this equation")
        translator.body.append("</span>")
    translator.body.append("</div>")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer; ``html_math_renderer = "svg"`` chooses it."""
    app.add_html_math_renderer("svg", (visit_inline, None), (visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
