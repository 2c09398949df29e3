"""Search the offsets of set points that a utility's coordination study would choose.

`python -m docs.studies.coordination SCENARIO` moves the offset of one regulator after the other, in smaller and smaller
steps, to the least mean cost of validation episodes without any other control. Timers integrate. It prints the offsets,
and the costs of no control, the tuned droop of the preset and MPC in test episodes before and after.
"""

import sys
from typing import Any

from dcgrid_env import Scenario, make_scenario
from dcgrid_env.baselines import make_controller, rollout

EPISODES = 32
"""Validation episodes of the search."""
STEPS_V = (2.0, 1.0, 0.5, 0.2, 0.1)
"""Sizes of the moves, V."""
FARTHEST_V = 6.0
SHOWN = ("none", "droop-tuned", "mpc-one-step", "mpc")
TEST_EPISODES = 100


def with_offsets(name: str, offset_v: dict[str, float], split: str = "validation") -> Scenario:
    """The scenario with these offsets by regulator and integrating timers."""
    settings: dict[str, Any] = {"timer": "integrating", "offset_v": offset_v}
    return make_scenario(name, split=split, **{"grid_control.regulator_settings": settings})


def mean_cost(
    name: str,
    offset_v: dict[str, float],
    controller: str = "none",
    episodes: int = EPISODES,
    split: str = "validation",
) -> float:
    """Mean J over the first episodes of a split."""
    law = make_controller(controller, make_scenario(name))
    return float(rollout(with_offsets(name, offset_v, split), law, range(episodes)).costs().mean())


def coordinated(name: str) -> dict[str, float]:
    """The offset of each regulator, V, by coordinate search from zero."""
    offset_v = dict.fromkeys(make_scenario(name).feeder.network.regulator.name, 0.0)
    least = mean_cost(name, offset_v)
    for step_v in STEPS_V:
        moved = True
        while moved:
            moved = False
            for regulator in offset_v:
                for way in (step_v, -step_v):
                    tried = offset_v | {regulator: round(offset_v[regulator] + way, 1)}
                    if abs(tried[regulator]) > FARTHEST_V:
                        continue
                    cost = mean_cost(name, tried)
                    if cost < least:
                        offset_v, least, moved = tried, cost, True
                        break
    return offset_v


def main(name: str) -> None:
    """Print the offsets and a table of costs."""
    found = coordinated(name)
    print(found)
    print("| set points | " + " | ".join(SHOWN) + " |")
    print("|---" * (len(SHOWN) + 1) + "|")
    for what, offset_v in (("published", dict.fromkeys(found, 0.0)), ("coordinated", found)):
        costs = [f"{mean_cost(name, offset_v, controller, TEST_EPISODES, 'test'):.3f}" for controller in SHOWN]
        print(f"| {what} | " + " | ".join(costs) + " |")


if __name__ == "__main__":
    main(sys.argv[1])
