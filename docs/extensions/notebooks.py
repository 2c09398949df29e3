"""Notebooks that are executed when the site is built: the folder of their pictures, and a check of their stderr."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util import logging

COMPILING = "dcgrid: compiling kernels"
"""Begins the line on stderr where kernels are compiled for the first time; the site does not show it."""
LOG = logging.getLogger(__name__)


def keep_pictures_with_the_site(app: Sphinx) -> None:
    """Write pictures into the site's own folder, not into ``jupyter_execute`` in the folder above it."""
    output_folder = str(Path(app.doctreedir) / "jupyter_execute")
    app.env.mystnb_config = app.env.mystnb_config.copy(output_folder=output_folder)  # type: ignore[attr-defined]


def check_stderr(app: Sphinx, doctree: nodes.document) -> None:
    """Warn if a cell writes to stderr, so that the build fails under ``-W``."""
    for block in [found for found in doctree.findall(nodes.literal_block) if "stderr" in found["classes"]]:
        if lines := [line for line in block.astext().splitlines() if not line.startswith(COMPILING)]:
            LOG.warning("a cell writes to stderr: %s", "\n".join(lines), location=block)
        block.parent.remove(block)


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the functions of this file, and give torch one thread: two wait long for each other on a busy machine."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    app.connect("builder-inited", keep_pictures_with_the_site, priority=900)  # after myst_nb has set its own
    app.connect("doctree-read", check_stderr)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
