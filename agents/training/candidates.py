"""Networks of many candidates, which act together on a batch of environments."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dcgrid_env import DcgridVectorEnv, Scenario
from dcgrid_env.agents.policy.interface import PolicyInterface
from dcgrid_env.agents.policy.neural_network import ACTIVATIONS, Network
from dcgrid_env.agents.training.row_batch import CLIP
from dcgrid_env.baselines.equipment_agents import EquipmentAgents
from dcgrid_env.baselines.laws.constant_set_points import CHANNELS, ConstantSetPoints, open_set_points
from dcgrid_env.baselines.laws.static import ConstantQ

ACTIVATION = "tanh"


class Candidates:
    """Convert parameter vectors to networks, and compute the costs of many at once.

    A vector contains weight and bias of each layer, for one network after the other. The set points that agents choose
    follow: 0 is the default, and 1 is half the range above it. With ``outputs="constant"`` each agent's constant share
    of its reactive limit is last.

    Parameters
    ----------
    interface
        Interface between networks and scenario.
    moments
        Mean and standard deviation of each network's inputs, (n_in,) each, float32.
    hidden
        Widths of the hidden layers.
    scenario
        The scenario, with agents of set points if it has any.
    law
        Law from whose constants the search starts; without, from the default set points.
    """

    def __init__(
        self,
        interface: PolicyInterface,
        moments: Mapping[str, tuple[np.ndarray, np.ndarray]],
        hidden: Sequence[int],
        scenario: Scenario,
        law: ConstantQ | None = None,
    ):
        self._points = [point for point in open_set_points(scenario) if point.by_agent]
        self.interface, self.moments = interface, moments
        chosen = law.set_points if isinstance(law, ConstantSetPoints) else {}
        self._at_start = [
            2.0 * (chosen[channel][point.name] - point.default) / ((point.highest - point.lowest) or 1.0)
            if point.name in chosen.get(channel := CHANNELS[point.parameter], {})
            else 0.0
            for point in self._points
        ]
        shares = np.zeros(interface.scenario.n_agents) + (0.0 if law is None else law.q_share)
        self._shares = shares[interface.q_agents] if interface.outputs == "constant" else np.empty(0)
        self._shapes = {
            name: list(itertools.pairwise((n_in, *hidden, n_out))) for name, (n_in, n_out) in interface.widths.items()
        }

    def start(self, rng: np.random.Generator) -> np.ndarray:
        """Return initial parameters, (n,): random hidden layers, and outputs of 0."""
        parts = []
        for shapes in self._shapes.values():
            for i, (n_in, n_out) in enumerate(shapes):
                std = n_in**-0.5 if i < len(shapes) - 1 else 0.0
                parts += [std * rng.standard_normal(n_in * n_out), np.zeros(n_out)]
        return np.concatenate([*parts, self._at_start, self._shares])

    def set_points(self, parameters: np.ndarray) -> dict[str, dict[str, Any]]:
        """Return the set points by channel and bank for parameters (..., n): floats, or arrays (...)."""
        chosen: dict[str, dict[str, Any]] = {}
        begin = parameters.shape[-1] - len(self._points) - len(self._shares)
        values = parameters[..., begin : begin + len(self._points)]
        for i, point in enumerate(self._points):
            moved = point.default + 0.5 * (point.highest - point.lowest) * values[..., i]
            within = np.clip(moved, point.lowest, point.highest)
            chosen.setdefault(CHANNELS[point.parameter], {})[point.name] = within if within.ndim else float(within)
        return chosen

    def q_share(self, parameters: np.ndarray) -> np.ndarray | None:
        """Return each agent's constant share of its reactive limit, (..., n_q); None if there are none."""
        n = len(self._shares)
        return parameters[..., parameters.shape[-1] - n :].clip(-1.0, 1.0) if n else None

    def layers(self, parameters: np.ndarray) -> dict[str, list[tuple[np.ndarray, np.ndarray]]]:
        """Return the layers of each network, weight (..., n_in, n_out) and bias (..., n_out), for parameters (..., n).

        The arrays are views.
        """
        layers, begin = {}, 0
        for name, shapes in self._shapes.items():
            layers[name] = []
            for n_in, n_out in shapes:
                middle, end = begin + n_in * n_out, begin + (n_in + 1) * n_out
                weight = parameters[..., begin:middle].reshape(*parameters.shape[:-1], n_in, n_out)
                layers[name].append((weight, parameters[..., middle:end]))
                begin = end
        return layers

    def networks(self, parameters: np.ndarray) -> dict[str, Network]:
        """Return the networks of one candidate, by name, for parameters (n,)."""
        return {
            name: Network(layers, ACTIVATION, "none", *self.moments[name], CLIP)
            for name, layers in self.layers(parameters.astype(np.float32)).items()
        }

    def costs(self, parameters: np.ndarray, env: DcgridVectorEnv, seeds: Sequence[int]) -> np.ndarray:
        """Return J of each candidate on the same episodes, (candidate, episode).

        Parameters
        ----------
        parameters
            (candidate, n), float32
        env
            Environments, one for each candidate and episode.
        seeds
            Seeds of the episodes.
        """
        layers, n = self.layers(parameters), len(parameters)
        rows = np.repeat(parameters, len(seeds), axis=0)
        of_rows, self.interface.q_share = self.set_points(rows), self.q_share(rows)
        equipment = EquipmentAgents(env.scenario, set_points=of_rows)

        def of_networks(joint: np.ndarray) -> np.ndarray:
            inputs = self.interface.inputs(joint)
            outputs = {name: self._outputs(name, layers[name], seen, n) for name, seen in inputs.items()}
            return self.interface.action(joint, outputs)

        joint, _ = env.reset(seed=[*seeds] * n)
        j = np.full(env.num_envs, np.nan)
        for _ in range(env.scenario.horizon):
            joint, _, terminated, truncated, _ = env.step(equipment.act(joint, of_networks))
            over = (terminated | truncated) & np.isnan(j)  # after a collapse, another episode begins in the row
            j[over] = env.transition.j_so_far[over]
        return j.reshape(n, len(seeds))

    def _outputs(self, name: str, layers: Sequence[tuple[Any, Any]], inputs: np.ndarray, n: int) -> np.ndarray:
        """Return a network's outputs, (row, .., n_out), for its inputs (row, .., n_in); rows are of n candidates."""
        mean, std = self.moments[name]
        x = ((inputs - mean) / std).clip(-CLIP, CLIP).reshape(n, -1, inputs.shape[-1])
        for i, (weight, bias) in enumerate(layers):
            x = (ACTIVATIONS[ACTIVATION](x) if i else x) @ weight + bias[:, None]
        return x.reshape(*inputs.shape[:-1], -1)
