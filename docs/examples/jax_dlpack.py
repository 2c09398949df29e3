"""A policy in JAX, gradients through the grid: arrays pass between JAX and ``TensorEnv`` by DLPack, without a copy.

``TensorEnv`` computes with torch. What it observes becomes a JAX array and what the policy sets a tensor where they lie
(``jax.dlpack``, ``torch.from_dlpack``; on a GPU there as well). To torch's tape the policy is one operation,
``ByJax``, whose derivative is ``jax.vjp``, so that the cost of a whole episode has a gradient by the policy's weights.

    python docs/examples/jax_dlpack.py --updates 30
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import torch
import tyro

import dcgrid_env
from dcgrid_env.baselines import make_controller, rollout

SCENARIO = "khodr141"


def to_jax(tensor: torch.Tensor) -> jax.Array:
    """The tensor's memory as a JAX array."""
    return jnp.from_dlpack(tensor.detach().contiguous())


@jax.jit
def policy(weights, joint):
    """Joint actions in [-1, 1] of joint observations, (env, n)."""
    for w, b in weights[:-1]:
        joint = jnp.tanh(joint @ w + b)
    w, b = weights[-1]
    return jnp.tanh(joint @ w + b)


class ByJax(torch.autograd.Function):
    """The policy as an operation of torch; derivatives by its weights gather in ``gathered``."""

    @staticmethod
    def forward(ctx, joint, weights, gathered):
        """What the policy sets."""
        action, ctx.back = jax.vjp(policy, weights, to_jax(joint))
        ctx.gathered = gathered
        return torch.from_dlpack(action)

    @staticmethod
    def backward(ctx, slope):
        """The derivative by what was observed, that by the weights put aside."""
        by_weights, by_joint = ctx.back(to_jax(slope))
        ctx.gathered.append(by_weights)
        return torch.from_dlpack(by_joint), None, None


def episode_cost(env, seeds, weights, gathered) -> torch.Tensor:
    """Mean J of the episodes of these seeds."""
    joint, total = env.reset(seeds).requires_grad_(), torch.zeros(())  # or torch would not ask for the first derivative
    while not env.over:
        after = env.step(ByJax.apply(joint, weights, gathered))
        joint, total = after.observation, total + after.cost_j.mean()
    return total / env.scenario.horizon


@partial(jax.jit, static_argnames="rate")
def adam(weights, moments, slopes, update, rate):
    """One step of Adam (Kingma and Ba, arXiv 1412.6980), the gradient cut to norm 1; all three after it."""
    first, second = moments
    norm = jnp.sqrt(sum(jnp.sum(own * own) for own in jax.tree.leaves(slopes)))
    slopes = jax.tree.map(lambda own: own / jnp.maximum(1.0, norm), slopes)
    first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, first, slopes)
    second = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, second, slopes)
    grown, grown2 = 1.0 - 0.9**update, 1.0 - 0.999**update
    moved = jax.tree.map(lambda w, m, v: w - rate * (m / grown) / (jnp.sqrt(v / grown2) + 1e-8), weights, first, second)
    return moved, (first, second)


def main(updates: int = 40, num_envs: int = 32, learning_rate: float = 3e-3, hidden: int = 64) -> tuple[float, float]:
    """Train, and give the mean J of 20 validation episodes before and after."""
    torch.set_num_threads(1)
    env = dcgrid_env.TensorEnv(SCENARIO, like=torch.empty(0))
    judge = dcgrid_env.TensorEnv(SCENARIO, like=torch.empty(0), split="validation")
    spaces, rng = dcgrid_env.DcgridEnv(SCENARIO), np.random.default_rng(0)
    n_seen, n_set = spaces.observation_space.shape[0], spaces.action_space.shape[0]
    sizes = [(n_seen, hidden, 1.0), (hidden, hidden, 1.0), (hidden, n_set, 0.01)]
    weights = [
        (jnp.asarray(rng.normal(0.0, scale / np.sqrt(n), (n, m)), jnp.float32), jnp.zeros(m)) for n, m, scale in sizes
    ]
    moments = (jax.tree.map(jnp.zeros_like, weights),) * 2

    def judged():
        with torch.no_grad():
            return float(episode_cost(judge, range(20), weights, []))

    before = judged()
    for update in range(1, updates + 1):
        by_step = []
        episode_cost(env, range(update * num_envs, (update + 1) * num_envs), weights, by_step).backward()
        slopes = jax.tree.map(lambda *own: sum(own), *by_step)
        weights, moments = adam(weights, moments, slopes, update, learning_rate)
    after = judged()
    validation = judge.scenario
    droop = rollout(validation, make_controller("droop-tuned", validation), range(20)).costs().mean()
    print(f"mean J of 20 validation episodes: {before:.3f} before, {after:.3f} after, tuned droop {droop:.3f}")
    return before, after


if __name__ == "__main__":
    tyro.cli(main)
