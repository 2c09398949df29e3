"""The command ``dcgrid check``."""

from __future__ import annotations

from dataclasses import dataclass

import tyro

from dcgrid_env.cli.settings import Overrides
from dcgrid_env.cli.terminal import plain_console, say
from dcgrid_env.cli.workers import OverWorkers


@dataclass(frozen=True)
class Check(OverWorkers):
    """Check in a minute whether a scenario is worth learning on.

    What no control, the droop, the best constant and perfect foresight reach in a few episodes, as a table and in plain
    words: whether there is anything to gain, whether the band can be kept, what the clock is worth, how large the
    droop's gain may be, and what to change.
    """

    scenario: tyro.conf.Positional[str]
    """Name of a scenario (dcgrid list), path/to/file.toml, or path/to/file.py:function or package.module:function that
    makes your own."""
    set: Overrides = ()
    """Fields of the scenario to change, for instance --set datacenters.p_rated_kw=800 source_voltage_pu=1.05."""
    episodes: int = 8
    """Number of episodes: those of seeds 0, 1, .."""
    split: str = "validation"
    """Which episodes the seeds mean: train, validation, test or ood."""
    seconds: float = 40.0
    """Time after which nothing further is begun; all columns are then of fewer episodes, the same ones."""

    def run(self) -> None:
        """Look, print the table and what it says. ValueError for an invalid setting."""
        from dcgrid_env.baselines.sanity.scenario_check import check_scenario
        from dcgrid_env.baselines.scenario_spec import ScenarioSpec

        scenario = ScenarioSpec(self.scenario, self.set).make(self.split)
        console = plain_console()
        with console.status("") as status:
            check = check_scenario(
                scenario, self.episodes, self.seconds, self.place, lambda stage: status.update(f"{stage} ..")
            )
        console.print(check.table.rich(console.width))
        for verdict in check.verdicts:
            say(console, f"- {verdict}")
