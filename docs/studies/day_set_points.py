"""Score laws with constant set points on the day of ieee123-3ph, on the published scale of its preset.

`python -m docs.studies.day_set_points` runs the laws that `dcgrid tune` found on the day with agents of set points
(parameters in ``results/tuned.json``), and others for comparison, on test episodes. It prints a table.

Scores are those of the preset ``ieee123-3ph-day``: 0 is its tuned droop and 1 its hindsight, on the same episodes.
In the preset, regulators and capacitor banks are agents themselves. Loads, work and PV are the same in both scenarios.
Hindsight searches taps roughly and is not an upper bound there.
"""

from collections.abc import Sequence

import numpy as np

from dcgrid_env import Scenario, forecast, make_scenario
from dcgrid_env.baselines import make_controller, published, streaming_rollout
from dcgrid_env.baselines.score import score

PRESET = "ieee123-3ph-day"
OVERRIDES = {
    "grid_control.regulators": "setpoint",
    "grid_control.capacitors": "setpoint",
    "grid_control.regulator_settings": {"timer": "integrating"},
}
CONTROLLERS = ("none", "droop-tuned", "set-points-tuned", "static-tuned", "two-timescale-tuned")
EPISODES = 100
METRICS = {"J": "J", "tap_moves": "taps per day", "capacitor_switchings": "capacitor switchings per day"}


def results(scenario: Scenario, controller: str, seeds: Sequence[int]) -> dict[str, np.ndarray]:
    """Return each of ``METRICS`` in the episodes, (n_seed,)."""
    metrics = streaming_rollout(scenario, make_controller(controller, scenario), seeds).metrics()
    return {name: np.array([episode[name] for episode in metrics]) for name in METRICS}


def same_days(scenario: Scenario, other: Scenario, seed: int) -> bool:
    """Return whether loads, work and PV of an episode are the same in two scenarios."""
    one, two = forecast(scenario, seed), forecast(other, seed)
    fields = ("p_load_kw", "q_load_kvar", "p_ref_kw", "p_inverter_kw")
    return all(np.array_equal(getattr(one, field), getattr(two, field)) for field in fields)


def main(episodes: int = EPISODES, **overrides: object) -> None:
    """Print the table."""
    seeds = range(episodes)
    preset = make_scenario(PRESET, split="test", **overrides)
    scenario = preset.replace(**OVERRIDES)
    assert all(same_days(preset, scenario, seed) for seed in seeds)
    droop, hindsight = results(preset, "droop-tuned", seeds)["J"], published(preset)
    assert hindsight is not None
    print("| controller | score | " + " | ".join(METRICS.values()) + " |")
    print("|---" * (len(METRICS) + 2) + "|")
    for name in CONTROLLERS:
        found = results(scenario, name, seeds)
        value, low, high = score(found["J"], droop, hindsight.of(seeds).J).score
        means = " | ".join(
            f"{values.mean():.3f}" if key == "J" else f"{values.mean():.0f}" for key, values in found.items()
        )
        print(f"| `{name}` | {value:.3f} ({low:.3f} to {high:.3f}) | {means} |")


if __name__ == "__main__":
    main()
