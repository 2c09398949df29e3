"""Search the offsets of set points that a utility's coordination study would choose.

`python -m docs.studies.laws.coordination ieee13-3ph.. [FIGURE.png]` begins with the published set points of each
preset. It moves the offset of one regulator after the other, in smaller and smaller steps, to the least mean cost of
validation episodes without any other control. Timers integrate and taps have no price. It prints the offsets, and the
costs of no control, the tuned droop of the published preset and MPC in test episodes before and after, and draws
them.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dcgrid_env import Scenario, make_scenario
from dcgrid_env.baselines import make_controller, rollout

EPISODES = 32
"""Validation episodes of the search."""
STEPS_V = (2.0, 1.0, 0.5, 0.2, 0.1)
"""Sizes of the moves, V."""
FARTHEST_V = 6.0
SHOWN = ("none", "droop-tuned", "mpc-one-step", "mpc")
TEST_EPISODES = 100
SET_POINTS = ("published", "coordinated")
LABELS = {"droop-tuned": "tuned\ndroop", "mpc-one-step": "one-step\nmpc"}
COLOURS = ("#9A9A9A", "#0072B2")
Costs = dict[str, list[float]]
"""Mean J of the controllers of ``SHOWN`` under each of ``SET_POINTS``."""


def with_offsets(name: str, offset_v: dict[str, float], split: str = "validation") -> Scenario:
    """The scenario with these offsets by regulator and integrating timers."""
    settings: dict[str, Any] = {"timer": "integrating", "offset_v": offset_v}
    return make_scenario(f"{name}-published", split=split, **{"grid_control.regulator_settings": settings})


def mean_cost(
    name: str,
    offset_v: dict[str, float],
    controller: str = "none",
    episodes: int = EPISODES,
    split: str = "validation",
) -> float:
    """Mean J over the first episodes of a split."""
    law = make_controller(controller, make_scenario(f"{name}-published"))
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


def costs_of(name: str) -> Costs:
    """Print the offsets and a table of costs in test episodes; return the costs."""
    found = coordinated(name)
    print(name, found)
    print("| set points | " + " | ".join(SHOWN) + " |")
    print("|---" * (len(SHOWN) + 1) + "|")
    costs = {}
    for what, offset_v in zip(SET_POINTS, (dict.fromkeys(found, 0.0), found), strict=True):
        costs[what] = [mean_cost(name, offset_v, controller, TEST_EPISODES, "test") for controller in SHOWN]
        print(f"| {what} | " + " | ".join(f"{cost:.3f}" for cost in costs[what]) + " |")
    return costs


def draw(by_scenario: dict[str, Costs], path: Path) -> None:
    """Draw a panel of bars for each scenario: controllers under published and coordinated set points."""
    figure = Figure(figsize=(3.2 * len(by_scenario), 3.4), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(by_scenario)))
    places = np.arange(len(SHOWN))
    for ax, (name, costs) in zip(panels, by_scenario.items(), strict=True):
        for side, (what, colour) in zip((-0.2, 0.2), zip(SET_POINTS, COLOURS, strict=True), strict=True):
            bars = ax.bar(places + side, costs[what], width=0.38, color=colour, label=f"{what} set points")
            ax.bar_label(bars, fmt="%.2f", fontsize=7, padding=1)
        ax.set_xticks(places, [LABELS.get(controller, controller) for controller in SHOWN])
        ax.set_title(name, fontsize=10)
        ax.spines[["top", "right"]].set_visible(False)
        ax.margins(y=0.12)
    panels[0].set_ylabel("mean cost J of a test episode")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False)
    figure.savefig(path, dpi=150)


def main(args: list[str]) -> None:
    """Run the study for each scenario, and draw a figure if a path is given."""
    pictures = [Path(arg) for arg in args if arg.endswith(".png")]
    by_scenario = {name: costs_of(name) for name in args if not name.endswith(".png")}
    for path in pictures:
        draw(by_scenario, path)


if __name__ == "__main__":
    main(sys.argv[1:])
