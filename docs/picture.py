"""Draw a picture of the documents: python docs/picture.py PATH [SCENARIO], the README's unless a scenario is given."""

import sys

import matplotlib.image

from dcgrid_env import DcgridEnv
from dcgrid_env.baselines import Droop

STEPS = 75


def draw(path: str, scenario: str = "ieee123") -> None:
    """Write the picture of a scenario's first test episode under the droop law after some steps."""
    env = DcgridEnv(scenario, split="test", render_mode="rgb_array")
    controller = Droop()
    observation, _ = env.reset(seed=0)
    controller.reset(env.scenario)
    for _ in range(min(STEPS, env.scenario.horizon - 1)):
        observation, *_ = env.step(controller.act(observation))
    matplotlib.image.imsave(path, env.render())
    env.close()


if __name__ == "__main__":
    draw(*sys.argv[1:])
