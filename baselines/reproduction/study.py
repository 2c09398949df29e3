"""The whole study: runs, records and figures."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from dcgrid_env.baselines.reproduction import bus13, levers, load_step, table1
from dcgrid_env.baselines.reproduction.claims import claims
from dcgrid_env.baselines.reproduction.paper import CITATION
from dcgrid_env.baselines.reproduction.study_runs import Runs

PARTS: dict[str, Callable[[Runs], Any]] = {
    "table_one": table1.table_one,
    "stability": table1.stability,
    "comparison": table1.comparison,
    "gains": table1.gains,
    "grids": table1.grids,
    "inverters": levers.inverters,
    "axes": levers.axes,
    "bus_thirteen": bus13.bus_thirteen,
    "intervals": levers.intervals,
    "step": load_step.step_response,
}
"""Parts of the study in the order in which they are run; the claims are made of them."""


def study(
    runs: Runs, on_part: Callable[[str], None] | None = None, parts: Iterable[str] = tuple(PARTS)
) -> dict[str, Any]:
    """Run the parts and hold the claims against them that they are made of.

    Parameters
    ----------
    runs
        Where the runs are done and kept.
    on_part
        Called with the name of each part before it begins.
    parts
        Which of :data:`PARTS` to run, all by default.

    Returns
    -------
    The records: ``setting``, the parts, and ``claims``; all JSON values.
    """
    setting = runs.setting
    records: dict[str, Any] = {
        "setting": {
            "paper": CITATION,
            "load": setting.load.kind,
            "load_description": setting.load.description,
            "placement": setting.placement,
            "sites": list(setting.sites),
            "episodes": setting.episodes,
            "counts": list(setting.counts),
        }
    }
    for name in parts:
        if on_part is not None:
            on_part(name)
        records[name] = PARTS[name](runs)
    records["claims"] = claims(records)
    return records
