"""A policy in JAX that is rolled out in one compiled scan: the native batch steps inside it through a callback.

The environments stay on the host. ``Batch.step`` is a function for ``jax.jit`` and ``jax.lax.scan``, which calls the
native batch by ``jax.experimental.io_callback``, in order. For a derivative through the grid, see jax_dlpack.py. The
script trains by an evolution strategy (Salimans et al., arXiv 1703.03864): each environment has another policy. At the
end it prints steps per second with and without JAX.

    python docs/examples/jax_callback.py --updates 60
"""

import time
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jax.experimental import io_callback

import dcgrid_env
from dcgrid_env.baselines import make_controller, rollout

SCENARIO = "ieee33-weak"


class Batch:
    """A native batch whose step can be traced.

    Parameters
    ----------
    num_envs
        Number of environments.
    **options
        Options of ``DcgridVectorEnv``, such as ``split`` and ``horizon``.
    """

    def __init__(self, num_envs: int, **options):
        self.envs = dcgrid_env.DcgridVectorEnv(num_envs, SCENARIO, **{"info": "none"} | options)
        n_observation, n_action = (space.shape[1] for space in self.spaces)
        self.sizes = n_observation, n_action
        self._result = (
            jax.ShapeDtypeStruct((num_envs, n_observation), np.float32),
            jax.ShapeDtypeStruct((num_envs,), np.float32),
        )

    @property
    def spaces(self):
        """Observation and action space of the batch."""
        return self.envs.observation_space, self.envs.action_space

    def reset(self, seed):
        """Begin the episodes of consecutive seeds; return joint observations, (env, n_observation)."""
        return jnp.asarray(self.envs.reset(seed=seed)[0])

    def step(self, action):
        """Advance by actions (env, n_action); return joint observations and rewards, (env,)."""
        return io_callback(self._step, self._result, action, ordered=True)

    def _step(self, action):
        observation, reward, *_ = self.envs.step(np.asarray(action))
        return observation, reward.astype(np.float32)


def policy(weights, joint):
    """Joint actions in [-1, 1] of the joint observation of one environment."""
    for w, b in weights[:-1]:
        joint = jnp.tanh(joint @ w + b)
    w, b = weights[-1]
    return jnp.tanh(joint @ w + b)


def weights_of(key, sizes):
    """Weights of a network with one hidden layer, whose actions are small at first."""
    n_observation, n_action = sizes
    first = jax.random.normal(key, (n_observation, 32)) / np.sqrt(n_observation)
    return [(first, jnp.zeros(32)), (jnp.zeros((32, n_action)), jnp.zeros(n_action))]


def episode_costs(batch, horizon):
    """Return a compiled function: weights (env, ...) and first observations to J of each environment's episode."""
    act = jax.vmap(policy)

    @jax.jit
    def run(weights, observation):
        def step(observed, _):
            after, reward = batch.step(act(weights, observed))
            return after, reward

        return -jax.lax.scan(step, observation, None, length=horizon)[1].mean(0)

    return run


@partial(jax.jit, static_argnames=("num_envs", "scale"))
def explored(weights, key, num_envs, scale):
    """Return weights of each environment and their noise; half of the environments have the opposite noise."""
    leaves, tree = jax.tree.flatten(weights)
    keys = jax.random.split(key, len(leaves))
    half = [jax.random.normal(k, (num_envs // 2, *w.shape)) for k, w in zip(keys, leaves, strict=True)]
    noise = [jnp.concatenate((each, -each)) for each in half]
    moved = [w + scale * each for w, each in zip(leaves, noise, strict=True)]
    return jax.tree.unflatten(tree, moved), jax.tree.unflatten(tree, noise)


@jax.jit
def improved(weights, noise, costs, rate):
    """Return weights moved along the noise of environments with low costs."""
    n = len(costs) // 2
    better = jnp.sign(costs[n:] - costs[:n])  # both of a pair have the same episode
    return jax.tree.map(lambda w, e: w + rate * jnp.tensordot(better, e[:n], 1) / n, weights, noise)


def steps_per_s(steps, course):
    """Steps in a second, by the fastest of ten runs of ``course``."""
    times = []
    for _ in range(10):
        began = time.perf_counter()
        course()
        times.append(time.perf_counter() - began)
    return steps / min(times)


def main(updates: int = 60, num_envs: int = 128, horizon: int = 120, seed: int = 0) -> tuple[float, float]:
    """Train, and return the mean J of 20 validation episodes before and after."""
    if num_envs % 2 or updates < 1:
        raise SystemExit(f"num_envs is {num_envs} and updates {updates}; give an even number and at least 1")
    batch = Batch(num_envs, horizon=horizon)
    run = episode_costs(batch, horizon)
    key = jax.random.key(seed)
    weights = weights_of(key, batch.sizes)

    validation = Batch(20, split="validation")
    whole = episode_costs(validation, validation.envs.scenario.horizon)

    def validated():
        same = jax.tree.map(lambda w: jnp.broadcast_to(w, (20, *w.shape)), weights)
        return float(whole(same, validation.reset(0)).mean())

    before = validated()
    for update in range(updates):
        key, of_noise = jax.random.split(key)
        tried, noise = explored(weights, of_noise, num_envs, 0.1)
        seeds = [update * num_envs + i % (num_envs // 2) for i in range(num_envs)]
        weights = improved(weights, noise, run(tried, batch.reset(seeds)), 0.3 * (1.0 - update / updates))
    after = validated()

    actions = np.zeros((num_envs, batch.sizes[1]), np.float32)
    first = batch.reset(0)
    by_loop = steps_per_s(num_envs * horizon, lambda: [batch.envs.step(actions) for _ in range(horizon)])
    in_scan = steps_per_s(num_envs * horizon, lambda: jax.block_until_ready(run(tried, first)))
    scenario = validation.envs.scenario
    droop = rollout(scenario, make_controller("droop-tuned", scenario), range(20)).costs().mean()
    print(f"mean J of 20 validation episodes: {before:.3f} before, {after:.3f} after, tuned droop {droop:.3f}")
    print(f"environment steps/s: {by_loop:,.0f} by NumPy without a policy, {in_scan:,.0f} in the scan with the policy")
    return before, after


if __name__ == "__main__":
    tyro.cli(main)
