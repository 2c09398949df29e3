"""The command ``dcgrid check``."""

from __future__ import annotations

from dataclasses import dataclass

import tyro

from dcgrid_env.core.commands.settings import Overrides
from dcgrid_env.core.commands.terminal import plain_console, say
from dcgrid_env.core.commands.workers import OverWorkers


@dataclass(frozen=True)
class Check(OverWorkers):
    """Check in a minute whether a scenario is worth learning on.

    Runs a few episodes with no control, the droop, the best constant action and perfect foresight. Prints a table and
    conclusions: whether control can improve the cost, whether the voltage band can be kept, how much the clock helps,
    which droop gains are stable, and what to change.
    """

    scenario: tyro.conf.Positional[str]
    """Scenario: a name (dcgrid list), path/to/file.toml, path/to/file.py:function or package.module:function."""
    set: Overrides = ()
    """Scenario fields to override, for example --set datacenters.p_rated_kw=800 source_voltage_pu=1.05."""
    episodes: int = 8
    """Number of episodes, with seeds 0, 1, ..."""
    split: str | None = None
    """Split of the episodes: train, validation, test, ood, or whole (all of load profiles and recordings). Default:
    whole for a scenario with load profiles or recordings, else validation."""
    allow: str = ""
    """unverified: go on with an imported feeder whose voltages are not those of the program that it comes from."""
    seconds: float = 40.0
    """Time limit for starting new work, s. After it, all columns use the same, smaller set of episodes."""

    def run(self) -> None:
        """Run the check, print the table and conclusions; raise ValueError if a setting is invalid."""
        from dcgrid_env.baselines.engineering import engineering_scenario, file_lines
        from dcgrid_env.baselines.sanity.scenario_check import check_scenario
        from dcgrid_env.baselines.scenario_spec import ScenarioSpec, voltage_line

        make = ScenarioSpec(self.scenario, self.set).make
        scenario = engineering_scenario(make, "validation") if self.split is None else make(self.split)
        console = plain_console()
        with console.status("") as status:
            check = check_scenario(
                scenario, self.episodes, self.seconds, self.place, lambda stage: status.update(f"{stage} ..")
            )
        say(console, voltage_line(scenario, self.set, self.scenario))
        console.print(check.table.rich(console.width))
        for line in file_lines(scenario):
            say(console, line)
        for verdict in check.verdicts:
            say(console, f"- {verdict}")
