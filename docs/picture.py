"""Draw a picture of the documents: python docs/picture.py PATH [SCENARIO], the README's unless a scenario is given."""

import sys

import matplotlib.image

from dcgrid_env import DcgridEnv
from dcgrid_env.baselines import Droop

env = DcgridEnv(sys.argv[2] if len(sys.argv) > 2 else "ieee123", split="test", render_mode="rgb_array")
controller = Droop()
observation, _ = env.reset(seed=0)
controller.reset(env.scenario)
for _ in range(75):
    observation, *_ = env.step(controller.act(observation))
matplotlib.image.imsave(sys.argv[1], env.render())
