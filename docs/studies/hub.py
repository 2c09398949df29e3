"""Write a policy as a folder for the Hugging Face hub."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.settings import Overrides, check_folder
from dcgrid_env.core.commands.terminal import plain_console, say, working


@dataclass(frozen=True)
class ExportHub(Command):
    """Write a policy as a folder for the Hugging Face hub.

    The folder has a model card (README.md) with the policy's figures on the test split, the policy with its card, and
    the configuration. Nothing is uploaded.
    """

    policy: tyro.conf.Positional[str]
    """Policy: a training run's folder, a policy file or a bundled policy (dcgrid list)."""
    out: Path
    """Folder to create; it must be new or empty."""
    scenario: str | None = None
    """Scenario of the test: a name (dcgrid list), path/to/file.toml, path/to/file.py:function or
    package.module:function. Default: the preset that the policy was trained on."""
    set: Overrides = ()
    """Fields of --scenario to override, for example --set horizon=60."""
    episodes: int = 100
    """Number of test episodes, at least 2, with seeds 0, 1, ..."""
    license: str = "mit"
    """License of the policy, as the hub abbreviates it, for example mit, apache-2.0 or cc-by-4.0."""

    def run(self) -> None:
        """Test, write and print; raise ValueError before writing if a setting is invalid."""
        from dcgrid_env.baselines.scenario_spec import ScenarioSpec
        from docs.studies.hub_export import export_hub

        if self.set and self.scenario is None:
            raise ValueError(f"set: must be given with --scenario, got {' '.join(self.set)}; add --scenario")
        check_folder(self.out)
        spec = None if self.scenario is None else ScenarioSpec(self.scenario, self.set)
        console = plain_console()
        with working(console, f"{self.episodes} test episodes"):
            tested = export_hub(self.policy, self.out, spec, self.episodes, self.license)
        figures = f"J {tested.policy.means['J']:.4f}, tuned droop {tested.droop.means['J']:.4f}"
        say(console, f"{tested.scenario.name}, {tested.scenario.split} split: {figures}")
        say(console, f"wrote {self.out}; upload it with the hub's client: hf upload USER/NAME {self.out}")
