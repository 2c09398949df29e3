"""TorchRL on ``TensorEnv``: collectors and losses take its tensors as they are, and no figure leaves torch.

``DcgridTensorEnv`` is TorchRL's ``EnvBase`` around ``dcgrid_env.TensorEnv``: a batch of episodes in step with each
other, the agents of a kind stacked as a group, each with its own observation, all paid by the team's cost. If the
power flow of an environment has no solution, the rest of its episode is charged at once, and it waits for the others to
end. As a script it compares what a collector takes through it and through ``PettingZooWrapper``:

    python docs/examples/torchrl_tensor_env.py --num-envs 64
"""

import time
from functools import partial

import numpy as np
import torch
import tyro
from tensordict import TensorDict, TensorDictBase
from torchrl.collectors import Collector
from torchrl.data import Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase, PettingZooWrapper

import dcgrid_env

SCENARIO = "ieee33-weak"
KINDS = {"datacenter": "dc_", "inverter": "inv_"}


class DcgridTensorEnv(EnvBase):
    """Episodes of a scenario of data centres and inverters as one TorchRL environment of that batch size.

    Episodes are those of the seeds ``seed, seed + 1, ..``, a new one for each environment at each reset.
    """

    batch_locked = True

    def __init__(self, scenario=SCENARIO, num_envs=64, seed=0, device="cpu", **overrides):
        super().__init__(device=torch.device(device), batch_size=torch.Size([num_envs]))
        self.grid = dcgrid_env.TensorEnv(scenario, like=torch.empty(0, device=device), **overrides)
        self.group_map, self._columns, self._bounds, cuts = {}, {}, {}, [0, 0]
        spaces = dcgrid_env.parallel_env(self.grid.scenario)
        for agent in spaces.possible_agents:
            kind = next((kind for kind, prefix in KINDS.items() if agent.startswith(prefix)), None)
            if kind is None:
                raise ValueError(f"agent {agent} is neither data centre nor inverter; add its kind to KINDS")
            seen, acted = spaces.observation_space(agent), spaces.action_space(agent)
            self.group_map.setdefault(kind, []).append(agent)
            own = self._columns.setdefault(kind, ([], []))
            for columns, space, i in ((own[0], seen, 0), (own[1], acted, 1)):
                columns.append(list(range(cuts[i], cuts[i] + space.shape[0])))
                cuts[i] += space.shape[0]
            bounds = self._bounds.setdefault(kind, ([], []))
            for limits, values in zip(bounds, (seen.low, seen.high), strict=True):
                limits.append(values)
        for kind, columns in self._columns.items():
            self._columns[kind] = tuple(torch.tensor(own, device=device) for own in columns)
            self._bounds[kind] = tuple(torch.tensor(np.array(own), device=device) for own in self._bounds[kind])
        self._n_action, self._next_seed = cuts[1], seed
        self._make_specs(num_envs)

    def _make_specs(self, num_envs):
        seen, acted, paid = {}, {}, {}
        for kind, agents in self.group_map.items():
            low, high = (limit.expand(num_envs, *limit.shape) for limit in self._bounds[kind])
            shape = (num_envs, len(agents))
            seen[kind] = Composite(observation=Bounded(low, high, device=self.device), shape=shape)
            box = Bounded(-1.0, 1.0, (*shape, self._columns[kind][1].shape[-1]), self.device)
            acted[kind] = Composite(action=box, shape=shape)
            paid[kind] = Composite(reward=Unbounded((*shape, 1), self.device), shape=shape)
        end = Categorical(2, (num_envs, 1), self.device, torch.bool)
        ends = {name: end.clone() for name in ("done", "terminated", "truncated")}
        self.observation_spec, self.action_spec = (
            Composite(seen, shape=(num_envs,)),
            Composite(acted, shape=(num_envs,)),
        )
        self.reward_spec, self.done_spec = Composite(paid, shape=(num_envs,)), Composite(ends, shape=(num_envs,))

    def _set_seed(self, seed):
        self._next_seed = seed or 0

    def _reset(self, tensordict: TensorDictBase | None = None, **_) -> TensorDictBase:
        num_envs = self.batch_size[0]
        seeds = range(self._next_seed, self._next_seed + num_envs)
        self._next_seed += num_envs
        return self._seen(self.grid.reset(list(seeds)), over=False)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        joint = torch.empty(*self.batch_size, self._n_action, device=self.device)
        for kind, (_, columns) in self._columns.items():
            joint[:, columns] = tensordict[kind, "action"].to(joint.dtype)
        after = self.grid.step(joint)
        out = self._seen(after.observation, over=self.grid.over)
        for kind, agents in self.group_map.items():
            out[kind, "reward"] = -after.cost_j.detach()[:, None, None].repeat(1, len(agents), 1)
        return out

    def _seen(self, joint, over):
        batch, end = self.batch_size, torch.full((*self.batch_size, 1), over, device=self.device)
        out = TensorDict({"truncated": end, "done": end.clone()}, batch, self.device)
        out["terminated"] = torch.zeros_like(end)
        for kind, agents in self.group_map.items():
            seen = joint.detach()[:, self._columns[kind][0]].clamp(*self._bounds[kind])
            out[kind] = TensorDict({"observation": seen}, (*batch, len(agents)), self.device)
        return out


def main(num_envs: int = 64, steps: int = 120) -> None:
    """Steps a second of a collector with random actions, through ``TensorEnv`` and through PettingZoo."""
    torch.set_num_threads(1)  # tensors as small as these lose with more
    ways = {
        f"TensorEnv, {num_envs} environments": (partial(DcgridTensorEnv, num_envs=num_envs), num_envs * steps),
        "PettingZooWrapper": (lambda: PettingZooWrapper(dcgrid_env.parallel_env(SCENARIO, info="none")), steps),
    }
    for name, (make, frames) in ways.items():
        collector = Collector(make, None, frames_per_batch=frames, total_frames=3 * frames)
        taken = iter(collector)
        next(taken)  # compiles what is to be
        begun = time.perf_counter()
        for _ in taken:
            pass
        print(f"{name}: {2 * frames / (time.perf_counter() - begun):,.0f} environment steps/s")
        collector.shutdown()


if __name__ == "__main__":
    tyro.cli(main)
