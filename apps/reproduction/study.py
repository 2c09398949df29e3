"""The whole study: its parts, their records, and the claims that they support or not."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from dcgrid_env.apps.reproduction import bus13, levers, load_step, table1
from dcgrid_env.apps.reproduction.claims import claims
from dcgrid_env.apps.reproduction.paper import CITATION
from dcgrid_env.apps.reproduction.study_runs import Run, Runs, Setting
from dcgrid_env.core.work.local_pool import ONE_PROCESS
from dcgrid_env.core.work.unit import Place, Unit, shared

Part = Callable[[Runs], Any]
"""A part of the study: the function that makes its records from the runs."""
PARTS: Mapping[str, Part] = {
    "table_one": table1.table_one,
    "comparison": table1.comparison,
    "gains": table1.gains,
    "grids": table1.grids,
    "inverters": levers.inverters,
    "bus_thirteen": bus13.bus_thirteen,
    "intervals": levers.intervals,
    "step": load_step.step_response,
}
"""Parts of the study in the order in which they are run; the claims are made of them."""
_RUNS = "runs of the paper's study"


class _PartRequest(NamedTuple):
    """A part of the study on one of several settings."""

    case: str
    part: str
    make: Part


def study(
    runs: Runs,
    on_part: Callable[[str], None] = lambda part: None,
    place: Place = ONE_PROCESS,
    parts: Mapping[str, Part] = PARTS,
) -> dict[str, Any]:
    """Run all parts and compare the claims with them.

    Parameters
    ----------
    runs
        Where the runs are kept.
    on_part
        Called with the name of each part when it is done.
    place
        Where the parts are run.
    parts
        Parts by name.

    Returns
    -------
    The records: ``setting``, the parts, and ``claims``; all JSON values.
    """
    (records,) = studies({"": runs}, parts, lambda _, part: on_part(part), place).values()
    return records


def studies(
    runs: Mapping[str, Runs],
    parts: Mapping[str, Part],
    on_part: Callable[[str, str], None] = lambda case, part: None,
    place: Place = ONE_PROCESS,
) -> dict[str, dict[str, Any]]:
    """Run parts of the study on several settings; the records of each by its name, as :func:`study` returns them.

    Parts run side by side do again what they have in common, which comes out the same.

    Parameters
    ----------
    runs
        Where the runs of each setting are kept.
    parts
        Parts by name.
    on_part
        Called with the names of the setting and of the part when it is done.
    place
        Where the parts are run.
    """
    units = [
        Unit(": ".join(filter(None, (case, part.replace("_", " ")))), _run_part, _PartRequest(case, part, make))
        for case in runs
        for part, make in parts.items()
    ]
    records: dict[str, dict[str, Any]] = {case: {} for case in runs}
    for unit, (record, done) in place.results(units, {_RUNS: runs}, how_to_go_on=""):
        case, part, _ = unit.item
        records[case][part] = record
        runs[case].done.update(done)
        on_part(case, part)
    return {
        case: _with_claims(case_runs.setting, {part: records[case][part] for part in parts})
        for case, case_runs in runs.items()
    }


def _run_part(request: _PartRequest) -> tuple[Any, Mapping[Any, Run]]:
    """The records of a part and the runs behind it; a worker keeps these for the parts that it runs next."""
    runs: Runs = shared(_RUNS)[request.case]
    before = set(runs.done)
    record = request.make(runs)
    return record, {key: run for key, run in runs.done.items() if key not in before}


def _with_claims(setting: Setting, records: Mapping[str, Any]) -> dict[str, Any]:
    """The setting, the parts' records, and the claims that they bear out or not."""
    about = {
        "paper": CITATION,
        "load": setting.load.kind,
        "load_description": setting.load.description,
        "placement": setting.placement,
        "sites": list(setting.sites),
        "episodes": setting.episodes,
        "counts": list(setting.counts),
    }
    whole = {"setting": about, **records}
    return whole | {"claims": claims(whole)}
