"""What tests run in other processes, in a module that imports no more than it takes: torch alone takes seconds."""

import gymnasium


def toy():
    """An environment of three steps."""
    return gymnasium.make("dcgrid_env:dcgrid/Toy6-v0", horizon=3)


def first_rewards(seed):
    """The first rewards of an episode under random actions."""
    env = gymnasium.make("dcgrid_env:dcgrid/IEEE123-v0")
    env.reset(seed=seed)
    env.action_space.seed(seed)
    return [env.step(env.action_space.sample())[1] for _ in range(10)]
