"""The command ``dcgrid dev transfer``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dcgrid_env.cli.command import Command
from dcgrid_env.cli.names import scenario_names, split_names
from dcgrid_env.cli.progress import progress_bar
from dcgrid_env.cli.settings import at_least, check_folder
from dcgrid_env.cli.terminal import plain_console, say
from dcgrid_env.core.versions import meta

BALANCED = "toy6,ieee123,ieee33-weak,ieee33,das69,khodr141,bursty,sync,training,mixed,fault,robust,scale-32"


@dataclass(frozen=True)
class Transfer(Command):
    """Score bundled policies on other scenarios than their own.

    Scores them unchanged and under guard.
    """

    scenarios: str = BALANCED
    """Names of presets separated by commas, or all (dcgrid list)."""
    algorithms: str = "analytic"
    """Algorithms separated by commas; their policies that ship for these scenarios are run on all of them."""
    episodes: int = 20
    """Episodes of each pair: seeds 0, 1, ..; at least 2, on the test split at most the published 100."""
    split: str = "test"
    """Whose episodes; on another than test what a policy saves is told as a share of what hindsight saves on test."""
    out: Path = Path("results/transfer")
    """Folder for transfer.md."""

    def run(self) -> None:
        """Run all pairs, print, write. ValueError for a setting that cannot be, before anything is run."""
        from dcgrid_env.agents.studies import transfer
        from dcgrid_env.core.files import write_text

        scenarios, algorithms = scenario_names(self.scenarios), split_names(self.algorithms)
        at_least(self, episodes=2)
        policies = {name: transfer.policies_of(name, scenarios) for name in algorithms}
        if none := next((name for name, own in policies.items() if not own), None):
            raise ValueError(f"algorithms: no policy of {none!r} ships for these scenarios (dcgrid list)")
        transfer.require_published(scenarios, self.episodes, self.split)
        check_folder(self.out)
        console = plain_console()
        parts = []
        with progress_bar(console) as progress:
            bar = progress.add_task("scenarios", total=len(scenarios) * len(policies))
            for name, own in policies.items():
                results = []
                for row in transfer.rows(own, scenarios, self.episodes, self.split):
                    results.append(row)
                    progress.advance(bar)
                parts.append((name, results))
        for name, results in parts:
            console.print(transfer.summary(results, f"{name}, all pairs together").rich(console.width))
        text = transfer.markdown(parts, self.episodes, self.split, meta()["command"])
        write_text(self.out / "transfer.md", text)
        say(console, f"wrote {self.out / 'transfer.md'}")
