"""Features of Stable-Baselines3's policies: scaled observations."""

from __future__ import annotations

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from dcgrid_env.agents.training.row_batch import CLIP


class Normalised(BaseFeaturesExtractor):
    """Features: the observation less its mean, over its standard deviation, cut at +-10."""

    mean: torch.Tensor
    std: torch.Tensor

    def __init__(self, observation_space: spaces.Box, mean: np.ndarray, std: np.ndarray):
        super().__init__(observation_space, features_dim=observation_space.shape[0])
        self.register_buffer("mean", torch.as_tensor(mean, dtype=torch.float32))
        self.register_buffer("std", torch.as_tensor(std, dtype=torch.float32))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Features of observations, (..., n_observation) each."""
        return ((observations - self.mean) / self.std).clamp(-CLIP, CLIP)
