"""A replay of episodes that opens in any browser: one file with the page, its plotting library and the data in it."""

from __future__ import annotations

import base64
import gzip
import html
import importlib
import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.colors
import numpy as np

from dcgrid_env.core.files import write_text
from dcgrid_env.core.suggestions import from_clone
from dcgrid_env.engine.record.episode_record import Series
from dcgrid_env.rendering.feeder_map import VOLTAGE_CMAP, voltage_norm
from dcgrid_env.rendering.map_panel import time_unit
from dcgrid_env.rendering.replay_course import SHOWN, course
from dcgrid_env.rendering.replay_map import feeder_map
from dcgrid_env.rendering.replay_terms import TERMS
from dcgrid_env.scenario.scenario import Scenario

MOST_RUNS = 4
"""Episodes that stand side by side at most."""
MOST_VALUES = 1_500_000
"""Voltages that a page holds at most, over all its episodes: beyond it would be larger than 6 MB."""
_ASSETS = "dcgrid_env.rendering.replay_assets"
_SCRIPTS = ("course.js", "tip.js", "feeder_map.js", "curves.js", "page.js")
_COLOURS = 11
"""Colours of the voltages' scale that the page is given; it mixes those between."""


class Replay:
    """A page that replays episodes; a notebook shows it, ``write`` makes a file of it."""

    def __init__(self, text: str):
        self.html = text

    def write(self, path: str | Path) -> Path:
        """Write the page to a file, whole or not at all; its path. OSError where it cannot be written."""
        write_text(Path(path), self.html)
        return Path(path)

    def _repr_html_(self) -> str:
        """Return the page in a separate frame, as notebooks show it."""
        inner = html.escape(self.html, quote=True)
        return f'<iframe srcdoc="{inner}" style="width:100%;height:900px;border:0" title="replay"></iframe>'


def replay(history: Series | Sequence[Series] | Mapping[str, Series], title: str | None = None) -> Replay:
    """Return a page that replays one episode, or the same episode under several controllers side by side.

    Parameters
    ----------
    history
        One or several episodes from :class:`dcgrid_env.Recorder` or ``dcgrid_env.baselines.rollout``; a mapping has the
        controllers' names as keys.
    title
        Title of the page; the scenario and its split by default.

    Raises
    ------
    ValueError
        Without an episode, for more than ``MOST_RUNS``, or for episodes that differ in more than the actions or are too
        long for a page. Also if the extra ``replay`` is not installed.
    """
    runs = _named(history)
    _check(runs)
    first = next(iter(runs.values()))
    s = first.scenario
    norm = voltage_norm(s.cost.band_pu)
    data = {
        "title": title or f"{s.name}, {s.split} split",
        "time": [s.dt_s / time_unit(s)[0], time_unit(s)[1]],
        "dt_s": s.dt_s,
        "horizon": s.horizon,
        "band_pu": s.cost.band_pu,
        "colours": _colours(),
        "range_pu": [norm.vmin, norm.vmax],
        "shown": {name: list(figure) for name, figure in SHOWN.items()},
        "terms": TERMS,
        "map": feeder_map(first),
        "runs": [{"name": name} | course(run) for name, run in runs.items()],
    }
    return Replay(_page(data))


def check_size(scenario: Scenario, n_runs: int) -> None:
    """ValueError for more episodes of a scenario than a page holds; before they are run."""
    if n_runs > MOST_RUNS:
        raise ValueError(f"{n_runs} episodes do not fit side by side; replay {MOST_RUNS} at most")
    per_step = scenario.feeder.n_node * n_runs
    if per_step * (scenario.horizon + 1) > MOST_VALUES:
        most = MOST_VALUES // per_step - 1
        raise ValueError(
            f"{n_runs} x {scenario.horizon:,} steps at {scenario.feeder.n_node} nodes are too much for one page; "
            f"replay fewer controllers, or an episode of {most:,} steps at most (--set horizon={most})"
        )


def plotting_script() -> str:
    """Plotly's JavaScript, from its Python package; ValueError where that is not installed."""
    try:
        return importlib.import_module("plotly.offline").get_plotlyjs()
    except ImportError:
        raise ValueError(f"a replay is drawn by plotly; install it, {from_clone('replay')}") from None


def _named(history: Any) -> dict[str, Series]:
    if isinstance(history, Series):
        return {"episode": history}
    if isinstance(history, Mapping):
        return {str(name): run for name, run in history.items()}
    if isinstance(history, str) or not isinstance(history, Sequence):
        raise ValueError(f"history is a {type(history).__name__}; give what Recorder.series returns, one or several")
    return {f"episode {i + 1}": run for i, run in enumerate(history)}


def _check(runs: dict[str, Series]) -> None:
    if not runs:
        raise ValueError("history is empty; give at least one episode")
    for name, run in runs.items():
        if not isinstance(run, Series):
            raise ValueError(f"history {name!r} is a {type(run).__name__}; give what Recorder.series returns")
    first = next(iter(runs.values()))
    check_size(first.scenario, len(runs))
    for name, run in runs.items():
        s, other = first.scenario, run.scenario
        same = s.feeder is other.feeder or s.feeder.bus_ids == other.feeder.bus_ids
        same &= (s.dt_s, s.horizon, s.agents, s.split) == (other.dt_s, other.horizon, other.agents, other.split)
        same = same and np.array_equal(run.buses, first.buses) and np.array_equal(run.trace_start, first.trace_start)
        if not same:
            raise ValueError(f"history {name!r} is of another episode; replay runs of one scenario and one seed")


def _colours() -> list[str]:
    scale = matplotlib.colormaps[VOLTAGE_CMAP]
    return [matplotlib.colors.to_hex(scale(x)) for x in np.linspace(0.0, 1.0, _COLOURS)]


def _page(data: dict[str, Any]) -> str:
    assets = files(_ASSETS)

    def text(name: str) -> str:
        return assets.joinpath(name).read_text(encoding="utf-8")

    parts = {
        "title": html.escape(data["title"]),
        "style": text("page.css"),
        "plotly": _zipped_script(plotting_script()),
        "data": _zipped(json.dumps(data, separators=(",", ":"), allow_nan=False)),
        "script": "\n".join(text(name) for name in _SCRIPTS),
    }
    page = text("page.html")
    for name, part in parts.items():
        page = page.replace(f"<!-- {name} -->", part, 1)
    return page


@lru_cache(maxsize=1)
def _zipped_script(script: str) -> str:
    """Return the zipped drawing library, which takes seconds to compress and is the same for all pages."""
    return _zipped(script)


def _zipped(text: str) -> str:
    """Text as the page unpacks it: gzip, the same at each call, as base64."""
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()
