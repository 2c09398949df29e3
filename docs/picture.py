"""Draw the README's picture: python docs/picture.py PATH."""

import sys

import matplotlib.image

from dcgrid_env import DcgridEnv
from dcgrid_env.baselines import Droop

env = DcgridEnv("ieee123", split="test", render_mode="rgb_array")
controller = Droop()
observation, _ = env.reset(seed=0)
controller.reset(env.scenario)
for _ in range(75):
    observation, *_ = env.step(controller.act(observation))
matplotlib.image.imsave(sys.argv[1], env.render())
