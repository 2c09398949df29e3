"""A batch of environments on random feeders: those on one feeder are stepped together, as a simulation of it."""

from __future__ import annotations

import numpy as np

from dcgrid_env.engine.exogenous.episode import EpisodeOptions
from dcgrid_env.engine.simulation import Simulation
from dcgrid_env.engine.snapshot import Snapshot, Transition, joined, taken
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.scenario.errors import ScenarioError
from dcgrid_env.scenario.members import grouped, on_batch
from dcgrid_env.scenario.scenario import Scenario


def simulation(scenario: Scenario, n_env: int) -> Simulation:
    """Return the simulation of a number of environments, on one feeder or on random ones."""
    kind = FamilySimulation if isinstance(scenario.feeder, RandomFeeders) else Simulation
    return kind(scenario, n_env)


class FamilySimulation(Simulation):
    """Environments of one scenario on random feeders.

    Which feeder an episode is on follows from its seed and number, so that a snapshot says all, as on one feeder.
    """

    _batch: tuple[np.ndarray, np.ndarray, Simulation] | None = None
    """Seeds and numbers of the episodes, and what steps them as long as these stay."""

    def step(self, action: np.ndarray) -> Transition:
        """Advance every environment by one step: devices all at once, the power flow feeder by feeder."""
        now = self.now
        if self._batch is None or self._batch[0] is not now.seeds or self._batch[1] is not now.numbers:
            groups = grouped(self.scenario, now.seeds, now.numbers)
            on = groups[0][0] if len(groups) == 1 else on_batch(self.scenario, groups)
            self._batch = (now.seeds, now.numbers, Simulation(on, self.n_env))
        on_feeders = self._batch[2]
        on_feeders.go_on(now._replace(scenario=on_feeders.scenario))
        on_feeders.step(action)
        self._now = on_feeders.now._replace(scenario=self.scenario)
        return self._now.transition

    def scenario_of(self, env_index: int) -> Scenario:
        """The scenario on the feeder that an environment's episode is on; RuntimeError before the first reset."""
        return grouped(
            self.scenario, self.now.seeds[env_index : env_index + 1], self.now.numbers[env_index : env_index + 1]
        )[0][0]

    def _drawn(self, seed: np.ndarray, number: np.ndarray, options: EpisodeOptions | None = None) -> Snapshot:
        if options is not None:
            raise ScenarioError(
                f"scenario {self.scenario.name!r} is on random feeders, where no buses can be given; make it on one of "
                "them, scenario.member(seed)"
            )
        groups = grouped(self.scenario, seed, number)
        parts = [
            (env_indices, Simulation(member, len(env_indices))._drawn(seed[env_indices], number[env_indices]))
            for member, env_indices in groups
        ]
        return joined(self.scenario, parts)

    def _merged(self, now: Snapshot, drawn: Snapshot, env_indices: np.ndarray) -> Snapshot:
        others = np.setdiff1d(np.arange(self.n_env), env_indices)
        return joined(self.scenario, [(others, taken(now, others, self.scenario)), (env_indices, drawn)])
