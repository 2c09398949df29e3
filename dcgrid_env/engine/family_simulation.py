"""A batch of lanes on random feeders: those on the same feeder are stepped together, as a simulation of that member."""

from __future__ import annotations

import numpy as np

from dcgrid_env.engine.simulation import Simulation
from dcgrid_env.engine.snapshot import Snapshot, Transition, joined, taken
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.scenario.members import grouped
from dcgrid_env.scenario.scenario import Scenario


def simulation(scenario: Scenario, lanes: int) -> Simulation:
    """What runs a number of lanes of a scenario, on one feeder or on random ones."""
    kind = FamilySimulation if isinstance(scenario.feeder, RandomFeeders) else Simulation
    return kind(scenario, lanes)


class FamilySimulation(Simulation):
    """Lanes of one scenario on random feeders.

    Which feeder an episode is on follows from its seed and number, so that a snapshot says all, as on one feeder.
    """

    def step(self, action: np.ndarray) -> Transition:
        """Advance every lane by one step, those of each feeder together."""
        now, parts = self.now, []
        for member, lanes in grouped(self.scenario, now.seeds, now.numbers):
            part = Simulation(member, len(lanes))
            alone = len(lanes) == self.lanes
            part.go_on(now._replace(scenario=member) if alone else taken(now, lanes, member))
            part.step(action if alone else action[lanes])
            parts.append((lanes, part.now))
        self._now = joined(self.scenario, parts)
        return self._now.transition

    def scenario_of(self, lane: int) -> Scenario:
        """The scenario on the feeder that a lane's episode is on; RuntimeError before the first reset."""
        return grouped(self.scenario, self.now.seeds[lane : lane + 1], self.now.numbers[lane : lane + 1])[0][0]

    def _drawn(self, seed: np.ndarray, number: np.ndarray) -> Snapshot:
        groups = grouped(self.scenario, seed, number)
        parts = [(at, Simulation(member, len(at))._drawn(seed[at], number[at])) for member, at in groups]
        return joined(self.scenario, parts)

    def _merged(self, now: Snapshot, drawn: Snapshot, lanes: np.ndarray) -> Snapshot:
        others = np.setdiff1d(np.arange(self.lanes), lanes)
        return joined(self.scenario, [(others, taken(now, others, self.scenario)), (lanes, drawn)])
