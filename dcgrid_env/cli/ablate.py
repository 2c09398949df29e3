"""The command ``dcgrid dev ablate``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dcgrid_env.cli.names import one_scenario, scenario_names, split_names
from dcgrid_env.cli.settings import check_folder
from dcgrid_env.cli.terminal import plain_console, say, working
from dcgrid_env.cli.trainings import Study, do_trainings
from dcgrid_env.core.versions import meta

if TYPE_CHECKING:
    from dcgrid_env.agents import Policy


@dataclass(frozen=True)
class Ablate(Study):
    """Train a policy without some of its parts and score each.

    Also scores trained policies on other scenarios than their own.

    Trainings are kept in RUNS: an interrupted command goes on where it was, and what is done is not done again.
    """

    scenario: str = "ieee33-weak"
    """Name of a scenario (dcgrid list)."""
    policies: str = "analytic"
    """Policies to test on other scenarios: analytic for all of that name that ship, or names and files, separated by
    commas; or none. Those that are one network for all agents are left out."""
    transfer: str = "all"
    """Scenarios to test them on, separated by commas, or all."""
    runs: Path = Path("results/ablate")
    """Folder of the training runs."""
    out: Path = Path("results/ablate")
    """Folder for ablations.md."""

    def run(self) -> None:
        """Train, test, write. ValueError for a setting that cannot be, before anything is trained."""
        from dcgrid_env.agents.studies import ablation
        from dcgrid_env.agents.studies.learning_tables import brief
        from dcgrid_env.cli.train import ALGORITHMS
        from dcgrid_env.core.files import write_text

        scenario = one_scenario(self.scenario)
        policies, others = _policies(self.policies), scenario_names(self.transfer)
        chosen = self.settings()
        algorithms = {name: ALGORITHMS[name].configuration() for name in ("analytic", "safe")}
        runs = ablation.configs(algorithms, scenario, chosen, self.seeds, self.runs)
        check_folder(self.out)
        console = plain_console()
        failures = do_trainings((config for every in runs.values() for config in every), self.place, console)
        with working(console, f"{self.episodes} test episodes of {scenario}"):
            results = ablation.ablation(scenario, self.episodes, runs, failures)
            ablated = ablation.ablation_table(scenario, self.episodes, results)
        console.print(brief(ablated, "score", "J", "mean delay, s", "training, s").rich(console.width))
        transferred = None
        if policies:
            with working(console, f"{len(policies)} policies on {len(others)} scenarios"):
                transferred = ablation.transfer_table(policies, others, self.episodes)
            console.print(transferred.rich(console.width))
        write_text(self.out / "ablations.md", ablation.markdown(ablated, results, transferred, meta()["command"]))
        say(console, f"wrote {self.out / 'ablations.md'}")


def _policies(asked: str) -> dict[str, Policy]:
    """Policies for every number of agents, by name; PolicyError for what is none."""
    from dcgrid_env.agents import Policy
    from dcgrid_env.agents.policy.policy import SHIPPED

    names = []
    for name in split_names(asked):
        chosen = [policy for policy in SHIPPED if policy.endswith("-analytic")] if name == "analytic" else [name]
        names += [] if name == "none" else chosen
    policies = {name: Policy.load(name) for name in names}
    return {name: policy for name, policy in policies.items() if policy.kind == "shared"}
