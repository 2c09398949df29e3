"""Draw a picture of the documents, the README's by default.

Use: python -m docs.studies.pictures.picture PATH [SCENARIO [LAW]].
"""

import sys

import matplotlib.image

from dcgrid_env import DcgridEnv, Scenario, make_scenario
from dcgrid_env.baselines import make_controller

STEPS = 75
LONGEST = 300
"""Steps of an episode that is drawn whole; of a longer one the first 150 make the axes."""


def shown_scenario(preset: str) -> Scenario:
    """Test split of a preset, with a shorter horizon if the episode is long."""
    scenario = make_scenario(preset, split="test")
    return scenario if scenario.horizon <= LONGEST else make_scenario(scenario, horizon=2 * STEPS)


def draw(path: str, scenario: str = "ieee123", law: str = "droop") -> None:
    """Write the picture of a scenario's first test episode under a law after some steps."""
    drawn = shown_scenario(scenario)
    env = DcgridEnv(drawn, render_mode="rgb_array")
    controller = make_controller(law, drawn)
    observation, _ = env.reset(seed=0)
    controller.reset(drawn)
    for _ in range(min(STEPS, drawn.horizon - 1)):
        observation, *_ = env.step(controller.act(observation))
    matplotlib.image.imsave(path, env.render())
    env.close()


if __name__ == "__main__":
    draw(*sys.argv[1:])
