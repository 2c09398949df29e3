"""What each compiled twin gains: processor time of stepping an environment without it, over that with it.

Blocks with and without a twin alternate in one process, so that other work slows both alike; the median of the ratios
is printed for each number of environments in a batch.

    python -m docs.studies.speed.compiled_twins
    python -m docs.studies.speed.compiled_twins --presets ieee123 routing --rounds 25
"""

import argparse
import statistics
from time import process_time

import numpy as np

from dcgrid_env import DcgridVectorEnv
from dcgrid_env.core.formula import ROW_FUNCTIONS

PRESETS = ("ieee123", "ieee33-weak", "ieee33-weak-ups", "routing", "ieee13-3ph", "ieee123-3ph", "ride-through")
BATCHES = (1, 64)


def block(env, actions):
    """Processor time of an episode's first steps, s."""
    env.reset(seed=0)
    begin_s = process_time()
    for action in actions:
        env.step(action)
    return process_time() - begin_s


def without(twins, env, actions):
    """Processor time with the array form in the twin's place, s."""
    kernel = twins.kernel
    twins.kernel = twins.array_form
    try:
        return block(env, actions)
    finally:
        twins.kernel = kernel


def used_in(env, actions):
    """The pairs whose twin runs in the environment."""
    used, kernels = set(), {name: twins.kernel for name, twins in ROW_FUNCTIONS.items()}
    for name, twins in ROW_FUNCTIONS.items():
        twins.kernel = lambda *args, name=name: used.add(name) or kernels[name](*args)
    block(env, actions[:1])
    for name, twins in ROW_FUNCTIONS.items():
        twins.kernel = kernels[name]
    return sorted(used)


def main():
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--presets", nargs="+", default=PRESETS, help="environments to step")
    parser.add_argument("--rounds", type=int, default=15, help="blocks with and without each twin")
    args = parser.parse_args()
    print(f"| twin | environment | {' | '.join(f'batch of {n}' for n in BATCHES)} |\n|---|---|---:|---:|")
    for preset in args.presets:
        envs = [DcgridVectorEnv(n, preset) for n in BATCHES]
        rng = np.random.default_rng(0)
        shapes = [(int(600 / n**0.5), *e.action_space.sample().shape) for n, e in zip(BATCHES, envs, strict=True)]
        actions = [rng.uniform(-1.0, 1.0, shape) for shape in shapes]
        for name in used_in(envs[0], actions[0]):
            gains = []
            for env, given in zip(envs, actions, strict=True):
                without(ROW_FUNCTIONS[name], env, given)
                ratios = [without(ROW_FUNCTIONS[name], env, given) / block(env, given) for _ in range(args.rounds)]
                gains.append(f"{statistics.median(ratios):.3f}")
            print(f"| {name.rpartition('.')[2]} | {preset} | {' | '.join(gains)} |", flush=True)


if __name__ == "__main__":
    main()
