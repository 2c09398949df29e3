"""One network for each kind of agent as a policy of Stable-Baselines3, which acts on joint observations."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from stable_baselines3.common.policies import BasePolicy

from dcgrid_env.agents.policy.interface import PolicyInterface


class AgentNetworks(BasePolicy):
    """A network for each kind of agent, from joint observations to the outputs of all agents.

    Parameters
    ----------
    networks
        By the kind of the device.
    seen
        Gives their inputs.
    acting
        Makes a joint action of the outputs.
    """

    def __init__(
        self,
        *args: Any,
        networks: torch.nn.ModuleDict,
        seen: PolicyInterface,
        acting: PolicyInterface,
        **kwargs: Any,
    ):
        super().__init__(*args, **kwargs)
        self.networks, self.seen, self.acting = networks, seen, acting
        self.optimizer = self.optimizer_class(networks.parameters(), **self.optimizer_kwargs)

    def outputs(self, joint: torch.Tensor) -> torch.Tensor:
        """Outputs of all agents in the order of the joint action, (..., n_action)."""
        each = [self.networks[kind](inputs) for kind, inputs in self.seen.inputs(joint).items()]
        return torch.cat([output.reshape(*joint.shape[:-1], -1) for output in each], dim=-1)

    def action(self, joint: np.ndarray, outputs: torch.Tensor) -> np.ndarray:
        """The joint action that outputs mean after a joint observation, (env, n_action)."""
        return self.acting.action(joint, {"joint": outputs.cpu().numpy()})

    def _predict(self, observation: Any, deterministic: bool = False) -> torch.Tensor:
        """The mean's action."""
        return torch.as_tensor(self.action(observation.cpu().numpy(), self.outputs(observation)))
