"""Names of elements and times in results."""

from __future__ import annotations

from dcgrid_env import Feeder, Scenario
from dcgrid_env.grid import AnyFeeder


def branch_to(feeder: AnyFeeder, position: int) -> str:
    """Name the branch at a position in the loading, with the phase on three-phase feeders."""
    if isinstance(feeder, Feeder):
        return feeder.branch_names[position - 1]
    return f"{feeder.branch_names[feeder.node_bus[position] - 1]}, phase {feeder.node_ids[position][-1]}"


def time_text(scenario: Scenario, hour: float) -> str:
    """Return a time of a scenario's loads as text.

    With load profiles it is the date, or the number of the day from 1, and the time of day; otherwise the time of day.
    """
    table = scenario.load_profiles.file
    if table is not None:
        return table.time_text(hour)
    minutes = round(60.0 * hour) % 1440
    return f"{minutes // 60:02d}:{minutes % 60:02d}"
