"""What comes from outside in an interval, with its loads."""

from dcgrid_env.engine.exogenous import episode
from dcgrid_env.engine.physics.loads import drawn


def interval(scenario, of_episode, step, noise, p_ref=None):
    """The interval that ends at ``step``, and the load noise then; see ``episode.exogenous``."""
    p_ref = episode.p_ref_kw(scenario, of_episode, step) if p_ref is None else p_ref
    return drawn(scenario, episode.exogenous(scenario, of_episode, step, noise, p_ref))
