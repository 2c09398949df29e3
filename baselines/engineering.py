"""Scenarios of commands that answer questions on the user's files, to which train and test splits mean nothing."""

from __future__ import annotations

from collections.abc import Callable

from dcgrid_env import Scenario, recording_lines
from dcgrid_env.traces import WHOLE


def has_files(scenario: Scenario) -> bool:
    """Return whether a scenario follows load profiles or recordings."""
    return scenario.load_profiles.file is not None or not isinstance(scenario.workload.trace, str)


def engineering_scenario(make: Callable[[str], Scenario], split: str = "test") -> Scenario:
    """Make a scenario for an answer on the user's files: with all of its load profiles and recordings.

    Parameters
    ----------
    make
        Function that makes the scenario on a split.
    split
        Split of a scenario without files, which has only generated load.
    """
    scenario = make(WHOLE)
    return scenario if has_files(scenario) else make(split)


def file_lines(scenario: Scenario) -> list[str]:
    """Describe how episodes lie in the files of a scenario, a line each: part, repetition and clock."""
    if not has_files(scenario):
        return []
    table, traces = scenario.load_profiles.file, scenario.workload.trace
    names = [] if isinstance(traces, str) else [f"trace {trace.name}, {trace.duration_s:g} s" for trace in traces]
    names += [] if table is None else [f"{table.label}, {table.duration_h:g} h"]
    part = "the whole" if scenario.split == WHOLE else f"the {scenario.split} split"
    return [f"episodes lie in {part} of {' and of '.join(names)}", *recording_lines(scenario)]
