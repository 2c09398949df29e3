"""BenchMARL on dcgrid: MAPPO, IPPO and its other algorithms, on the tensors of ``torchrl_tensor_env.py``.

BenchMARL's ``Task`` and its configuration are below: a scenario, and fields of it that are to be otherwise. What is
trained is saved as a policy of dcgrid and scored on the validation split beside the tuned droop.

    python docs/examples/benchmarl_mappo.py --algorithm mappo --frames 230400 --save results/mappo
    dcgrid evaluate results/mappo.safetensors --scenario ieee33-weak
"""

import tempfile
from pathlib import Path
from typing import Literal

import torch
import tyro
from benchmarl.algorithms import IppoConfig, MappoConfig
from benchmarl.environments.common import Task, TaskClass
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from torch import nn
from torchrl_tensor_env import DcgridTensorEnv

import dcgrid_env
from dcgrid_env.agents import Network, Policy
from dcgrid_env.baselines import make_controller, rollout

ALGORITHMS = {"mappo": MappoConfig, "ippo": IppoConfig}


class DcgridClass(TaskClass):
    """What BenchMARL asks of a task; ``config`` has the scenario and fields that are to be otherwise."""

    def get_env_fun(self, num_envs, continuous_actions, seed, device):
        """A function that makes the environment."""
        return lambda: DcgridTensorEnv(num_envs=num_envs, seed=seed or 0, device=device, **self.config)

    def supports_continuous_actions(self):
        """All setpoints are continuous."""
        return True

    def supports_discrete_actions(self):
        """None is discrete."""
        return False

    def max_steps(self, env):
        """Steps of an episode."""
        return env.grid.scenario.horizon

    def has_render(self, env):
        """Tensors are not drawn."""
        return False

    def group_map(self, env):
        """The agents of each kind."""
        return env.group_map

    def observation_spec(self, env):
        """What each group sees."""
        return env.full_observation_spec_unbatched

    def action_spec(self, env):
        """What each group sets."""
        return env.full_action_spec_unbatched

    def info_spec(self, env):
        """Nothing beside."""
        return None

    def state_spec(self, env):
        """None: a centralised critic takes the observations of a group together."""
        return None

    def action_mask_spec(self, env):
        """Every action may always be taken."""
        return None

    @staticmethod
    def env_name():
        """Folder of the task's configuration in BenchMARL, had it one."""
        return "dcgrid"


class DcgridTask(Task):
    """The scenarios as tasks."""

    IEEE33_WEAK = None
    KHODR141 = None
    DAS69 = None

    @staticmethod
    def associated_class():
        """What makes them."""
        return DcgridClass


def exported(experiment: Experiment, scenario: str) -> Policy:
    """The groups' mean actions as a policy of NumPy arrays."""
    networks = {}
    for kind, actor in experiment.group_policies.items():
        flat = [values.detach().numpy().T.copy() for values in actor.parameters()]  # weight, bias of each layer in turn
        arrays = list(zip(flat[::2], flat[1::2], strict=True))
        weight, bias = arrays[-1]
        half = len(bias) // 2  # means first, then the scales
        networks[kind] = Network([*arrays[:-1], (weight[:, :half], bias[:half])], activation="tanh", squash="tanh")
    return Policy(networks, scenario=scenario)


def main(
    algorithm: Literal["mappo", "ippo"] = "mappo",
    task: str = "IEEE33_WEAK",
    frames: int = 230_400,
    num_envs: int = 32,
    learning_rate: float = 1e-3,
    gamma: float = 0.5,
    episodes: int = 20,
    seed: int = 0,
    save: Path | None = None,
) -> tuple[float, float]:
    """Train, and give the mean J of validation episodes before and after."""
    torch.set_num_threads(1)
    scenario = task.lower().replace("_", "-")
    chosen = DcgridTask[task].get_task({"scenario": scenario})
    batch = num_envs * dcgrid_env.make_scenario(scenario).horizon
    config = ExperimentConfig.get_from_yaml()
    config.max_n_frames, config.gamma, config.lr = max(frames, batch), gamma, learning_rate
    config.on_policy_collected_frames_per_batch, config.on_policy_n_envs_per_worker = batch, num_envs
    config.on_policy_minibatch_size, config.on_policy_n_minibatch_iters = batch // 4, 4
    config.loggers, config.evaluation, config.create_json = [], False, False
    validation = dcgrid_env.make_scenario(scenario, split="validation")
    with tempfile.TemporaryDirectory() as folder:
        config.save_folder = folder
        network = MlpConfig(num_cells=[64, 64], layer_class=nn.Linear, activation_class=nn.Tanh)
        experiment = Experiment(
            task=chosen,
            algorithm_config=ALGORITHMS[algorithm].get_from_yaml(),
            model_config=network,
            critic_model_config=network,
            seed=seed,
            config=config,
        )
        before = float(rollout(validation, exported(experiment, scenario), range(episodes)).costs().mean())
        experiment.run()
    policy = exported(experiment, scenario)
    after = float(rollout(validation, policy, range(episodes)).costs().mean())
    droop = rollout(validation, make_controller("droop-tuned", validation), range(episodes)).costs().mean()
    print(f"mean J of {episodes} validation episodes: {before:.3f} before, {after:.3f} after, tuned droop {droop:.3f}")
    if save:
        policy.save(save)
    return before, after


if __name__ == "__main__":
    tyro.cli(main)
