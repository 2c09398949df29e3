"""Compare the speed of this version and another one in alternating blocks.

Two processes alternate in blocks of a fraction of a second, so other work slows both alike. One uses this interpreter,
the other the interpreter of an environment with the other version. Rates are steps per second of wall time and of
processor time, for the best block and the median. With --busy a third process keeps a core busy. The computed values
of both versions are compared at the end.

    python -m docs.studies.speed.paired_speed ../before/.venv/bin/python make_vec tensor --rounds 10 --busy
    python -m docs.studies.speed.paired_speed --torch-threads 2 tensor tensor_gradient

The second command compares this version with itself, with torch on two threads inside TensorEnv and its derivative.
"""

# pyright: reportOptionalIterable=false, reportPossiblyUnboundVariable=false, reportOptionalMemberAccess=false
# pyright: reportIndexIssue=false, reportAttributeAccessIssue=false

import argparse
import hashlib
import statistics
import subprocess
import sys
from collections.abc import Callable
from contextlib import nullcontext
from copy import copy
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np


def make_vec(preset, num_envs=512):
    """A block of the native batch."""
    import dcgrid_env

    env = dcgrid_env.DcgridVectorEnv(num_envs, preset)
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (40, *env.action_space.shape)).astype(np.float32)

    def block():
        for action in actions:
            observation, reward, *_ = env.step(action)
        return num_envs * len(actions), (observation, reward)

    return block


def make(preset):
    """A block of one environment behind gymnasium's wrappers: 1,200 steps."""
    import gymnasium

    env = gymnasium.make("dcgrid_env:dcgrid/IEEE123-v0", scenario=preset)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (1200, *env.action_space.shape)).astype(np.float32)
    env.reset(seed=0)

    def block():
        for action in actions:
            observation, reward, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        return len(actions), (observation, np.array(reward))

    return block


def parallel_env():
    """A block of the multi-agent environment: ten episodes."""
    import dcgrid_env

    env, rng = dcgrid_env.parallel_env("ieee123"), np.random.default_rng(0)
    sizes = {agent: env.action_space(agent).shape for agent in env.possible_agents}
    actions = [{a: rng.uniform(-1.0, 1.0, size).astype(np.float32) for a, size in sizes.items()} for _ in range(1200)]
    env.reset(seed=0)

    def block():
        for action in actions:
            observations, rewards, *_ = env.step(action)
            if not env.agents:
                env.reset()
        return len(actions), (*observations.values(), np.array(list(rewards.values())))

    return block


def tensor(gradient=False, num_envs=1024, steps=20):
    """A block of torch tensors of float32, the first steps of episodes; the derivative of their cost by all actions."""
    import torch

    import dcgrid_env

    env = dcgrid_env.TensorEnv("ieee123", like=torch.empty(0))
    generator = torch.Generator().manual_seed(0)
    size = (steps, num_envs, dcgrid_env.action_layout(env.scenario).n)
    actions = (2.0 * torch.rand(size, generator=generator) - 1.0).requires_grad_(gradient)
    env.reset(range(256), copies=num_envs // 256)

    def block():
        again = copy(env)
        costs = torch.stack([again.step(action).cost_j.mean() for action in actions])
        actions.grad = None
        if gradient:
            costs.sum().backward()
        return num_envs * steps, (costs.detach().numpy(), actions.grad.numpy() if gradient else np.zeros(0))

    return block


def tensor_gradient():
    """``tensor`` with the derivative."""
    return tensor(gradient=True)


def tensor_4096():
    """``tensor`` with 4,096 environments."""
    return tensor(num_envs=4096)


def tensor_4096_gradient():
    """``tensor_4096`` with the derivative."""
    return tensor(gradient=True, num_envs=4096)


def analytic():
    """A block of training through the grid on ieee33-weak as ``dcgrid train analytic`` runs it: a whole batch."""
    import torch

    from dcgrid_env.agents.algorithms.analytic import Analytic, Learner, grids_of

    cfg = Analytic.for_scenario("ieee33-weak")
    torch.set_num_threads(cfg.threads)
    learner, done = Learner(cfg, grids_of(cfg)), iter(range(1, 10**9))

    def block():
        learner.episodes(0, next(done), lambda what, tensors: None)
        return cfg.num_envs * learner.envs[0].scenario.horizon, ()

    return block


KINDS: dict[str, Callable[..., Any]] = {
    f.__name__: f
    for f in (make_vec, make, parallel_env, tensor, tensor_gradient, tensor_4096, tensor_4096_gradient, analytic)
}
OF_PRESET = ("make_vec", "make")
"""Kinds that step the preset of ``--preset``."""


def left_to_torch(threads):
    """Have torch run on so many threads everywhere, TensorEnv's steps and their derivative among it."""
    import torch

    from dcgrid_env.core import torch_threads

    torch.set_num_threads(threads)
    torch_threads.one_torch_thread, torch_threads.rest_of_backward_on = nullcontext, lambda threads: None


def serve(kind, preset, torch_threads):
    """Run a block for each input line; print its rates and a hash of its results."""
    if torch_threads is not None:
        left_to_torch(torch_threads)
    block = KINDS[kind](preset) if kind in OF_PRESET else KINDS[kind]()
    block()
    print("ready", flush=True)
    for _ in sys.stdin:
        clock_s, cpu_s = perf_counter(), process_time()
        steps, found = block()
        clock_s, cpu_s = perf_counter() - clock_s, process_time() - cpu_s
        figures = hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in found)).hexdigest()
        print(steps / clock_s, steps / cpu_s, figures, flush=True)


def measure(kind, preset, versions, rounds):
    """Run blocks of each version in turn; return the rates by wall and processor time, and whether the bits agree."""
    command = [str(Path(__file__).resolve()), "--serve", kind, "--preset", preset]
    processes = [
        subprocess.Popen([python, *command, *options], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for python, *options in versions
    ]
    try:
        for process in processes:
            if process.stdout.readline() != "ready\n":
                raise SystemExit(f"{process.args[0]} did not get ready for {kind}; its error stands above")
        answers = [[], []]
        for i in range(rounds):
            for k in (0, 1) if i % 2 else (1, 0):
                processes[k].stdin.write("\n")
                processes[k].stdin.flush()
                answers[k].append(processes[k].stdout.readline().split())
    finally:
        for process in processes:
            process.kill()
            process.communicate()
    rates = [np.array([answer[:2] for answer in own], float).T for own in answers]
    return rates, [a[2] for a in answers[0]] == [a[2] for a in answers[1]]


def main():
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", nargs="?", help="interpreter of an environment with the other version")
    parser.add_argument("kinds", nargs="*", help=f"what to measure, of {', '.join(KINDS)}; all by default")
    parser.add_argument("--torch-threads", type=int, help="hold this version against itself with so many of torch's")
    parser.add_argument("--preset", default="ieee123", help="what make and make_vec step; ieee123 by default")
    parser.add_argument("--rounds", type=int, default=10, help="blocks of each version")
    parser.add_argument("--busy", action="store_true", help="beside a process that keeps one core busy")
    parser.add_argument("--serve", choices=KINDS, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.serve:
        serve(args.serve, args.preset, args.torch_threads)
        return
    if args.torch_threads is None:
        other, names = [args.other], ("before", "now")
    else:
        args.kinds = [*filter(None, [args.other]), *args.kinds]
        threads = args.torch_threads
        other, names = [sys.executable, "--torch-threads", str(threads)], (f"on {threads} threads of torch", "as it is")
    if other == [None] or args.rounds < 1 or (args.torch_threads is not None and args.torch_threads < 1):
        parser.error("give the interpreter of the other version, or --torch-threads of 1 or more, and at least 1 round")
    if unknown := [kind for kind in args.kinds if kind not in KINDS]:
        parser.error(f"{unknown[0]} is nothing to measure; give of {', '.join(KINDS)}")
    busy = subprocess.Popen([sys.executable, "-c", "while True: pass"]) if args.busy else None
    print(f"| | steps/s {names[0]} | {names[1]} | times | median | by processor time | same bits |")
    print("|---|---|---|---|---|---|---|")
    try:
        for kind in args.kinds or KINDS:
            (before, now), same = measure(kind, args.preset, [other, [sys.executable]], args.rounds)
            best = [rates.max(axis=1) for rates in (before, now)]
            median = statistics.median(now[0]) / statistics.median(before[0])
            ratios = f"{best[1][0] / best[0][0]:.2f} | {median:.2f} | {best[1][1] / best[0][1]:.2f}"
            print(f"| {kind} | {best[0][0]:,.0f} | {best[1][0]:,.0f} | {ratios} | {same} |", flush=True)
    finally:
        if busy:
            busy.kill()
            busy.wait()


if __name__ == "__main__":
    main()
