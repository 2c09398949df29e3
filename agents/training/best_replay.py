"""Replay of the first validation episode under the best policy of a training run, next to the baseline."""

from __future__ import annotations

from pathlib import Path

from dcgrid_env import Scenario, Series
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.training.config import Training
from dcgrid_env.baselines import make_controller, rollout

REPLAY = "replay.html"
"""Name of the page in the folder of a training run."""
SEED = 0
"""Seed of the episode."""


class BestReplay:
    """Write the page of a run; each call replaces the page of the previous best policy.

    Parameters
    ----------
    folder
        Folder of the run.
    config
        Configuration of the run; its algorithm is the policy's name on the page.
    """

    def __init__(self, folder: Path, config: Training):
        self.path, self.name = folder / REPLAY, config.algorithm()
        self._reference: Series | None = None
        self._refused = False

    def write(self, policy: Policy, scenario: Scenario, reference: str) -> None:
        """Run the episode and write the page.

        If a page is not possible, because the extra ``replay`` is missing or the episode is too long, print the reason
        once and remove the page of an earlier policy.

        Parameters
        ----------
        policy
            The best policy so far.
        scenario
            Validation scenario, the same in each call.
        reference
            Name of the controller on the same page, the same in each call.
        """
        if self._refused:
            return
        from dcgrid_env.rendering import replay  # imports matplotlib

        if self._reference is None:
            self._reference = _episode(scenario, make_controller(reference, scenario))
        runs = {self.name: _episode(scenario, policy), reference: self._reference}
        try:
            page = replay(runs, f"{scenario.name}, {scenario.split} split, seed {SEED}")
        except ValueError as error:
            self._refused = True
            self.path.unlink(missing_ok=True)
            print(f"no {REPLAY}: {error}")
            return
        page.write(self.path)


def _episode(scenario: Scenario, controller: object) -> Series:
    return rollout(scenario, controller, [SEED]).series(0)  # pyright: ignore[reportArgumentType]
