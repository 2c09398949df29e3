"""What a scenario's grid may meet: loads, work and sun at moments drawn from its training episodes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env import Feeder, Scenario, forecast

FIRST_SEED = 1 << 44
"""The training episodes that moments are drawn from begin at this seed, far from those that policies are trained on."""
EPISODES = 48


class OperatingPoints(NamedTuple):
    """Moments of an operation without control, m of them; they do not depend on the agents' buses."""

    scenario: Scenario
    """Sources of the moments."""
    p_load_kw: np.ndarray
    """Other loads, kW, (m, n_leg)."""
    q_load_kvar: np.ndarray
    """Other loads, kvar, (m, n_leg)."""
    p_agent_kw: np.ndarray
    """What each agent would draw, kW, an inverter's injection negative, (m, n_agent); data centres at the top clock
    with nothing queued."""
    later: OperatingPoints | None = None
    """The moments a step later, if measurements have noise."""

    @property
    def sun(self) -> np.ndarray:
        """Sum of the inverters' injections, kW, (m,), which orders moments by their sun."""
        return np.maximum(-self.p_agent_kw, 0.0).sum(axis=1)

    def on(self, scenario: Scenario) -> OperatingPoints:
        """Carry the moments over to another member of the same random feeders, without drawing episodes.

        Each bus has the share of its nominal load that the bus at its place has here, or where that has no load, that
        of another one. ValueError where a feeder is not balanced or the buses are not as many.
        """
        feeder, other_feeder = self.scenario.feeder, scenario.feeder
        if not (isinstance(feeder, Feeder) and isinstance(other_feeder, Feeder) and feeder.n_bus == other_feeder.n_bus):
            raise ValueError(
                f"moments of {feeder.name!r} can be carried over to balanced feeders of as many buses alone, and not "
                f"to {other_feeder.name!r}; draw them anew"
            )
        loaded = np.flatnonzero(feeder.p_load_kw > 0.0)
        bus = loaded[np.arange(feeder.n_bus) % len(loaded)]
        bus[loaded] = loaded
        share = self.p_load_kw[:, bus] / feeder.p_load_kw[bus]
        fixed_kvar = other_feeder.capacitor_kvar if scenario.background.capacitors else 0.0
        p_kw, q_kvar = share * other_feeder.p_load_kw, share * other_feeder.q_load_kvar - fixed_kvar
        later = None if self.later is None else self.later.on(scenario)
        return OperatingPoints(scenario, p_kw, q_kvar, self.p_agent_kw, later)


def operating_points(scenario: Scenario, count: int) -> OperatingPoints:
    """Draw moments of the scenario's training split, the same for the same scenario.

    Parameters
    ----------
    scenario
        Data centres first and inverters behind them, see ``require_known_devices``.
    count
        How many moments, at the least.
    """
    training = scenario.replace(split="train")
    rng = np.random.default_rng(0)
    each = -(-count // EPISODES)
    parts: list[list[tuple[np.ndarray, ...]]] = [[], []]
    for seed in range(FIRST_SEED, FIRST_SEED + EPISODES):
        episode = forecast(training, seed)
        steps = rng.choice(scenario.horizon, min(each, scenario.horizon), replace=False)
        drawn = np.concatenate((episode.p_ref_kw, -episode.p_inverter_kw), axis=1)
        series = (episode.p_load_kw, episode.q_load_kvar, drawn)
        for part, part_steps in zip(parts, (steps, np.minimum(steps + 1, scenario.horizon - 1)), strict=True):
            part.append(tuple(values[part_steps] for values in series))
    (p_kw, q_kvar, drawn_kw), later = (tuple(map(np.concatenate, zip(*part, strict=True))) for part in parts)
    after = OperatingPoints(scenario, later[0], later[1], later[2]) if scenario.sensing.noise_pu else None
    return OperatingPoints(scenario, p_kw, q_kvar, drawn_kw, after)
