"""A policy that corrects the model-aided law, and so acts on a feeder that it never saw.

At ``reset`` and ``place`` it is given what the law is given, the feeder's model, all agents' places and ratings and the
statistics of their load, and works out the same (``baselines.model_aided``). Each second its networks see the law's
figures, one network for each kind of agent, and correct the law's decisions within bounds (``law_interface``). With
networks that give 0 it is the law.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.agents.policy.agent_groups import axes
from dcgrid_env.agents.policy.interface import PolicyInterface
from dcgrid_env.agents.policy.law_interface import FEATURES, OUTPUTS, LawInterface
from dcgrid_env.agents.policy.neural_network import PolicyError
from dcgrid_env.agents.policy.policy import Family, Policy
from dcgrid_env.baselines.equipment_agents import at_rest
from dcgrid_env.baselines.model_aided.law_step import Past
from dcgrid_env.baselines.model_aided.model_aided import ModelAided


class ModelAidedPolicy(Policy, features="law"):
    """A policy on the figures of the model-aided law.

    Parameters
    ----------
    networks
        ``{"datacenter": network, "inverter": network}``, from ``law_interface.FEATURES`` to as many figures as
        ``law_interface.OUTPUTS``.
    law
        Settings of the law by name, as ``ModelAided`` takes them; those that are not given are its defaults now.
    scenario, made_with
        See :class:`Policy`.

    Raises
    ------
    PolicyError
        For networks of other kinds or widths, or settings that the law has not.
    """

    scope: ClassVar[str] = "model-aided"

    def __init__(
        self,
        networks: Mapping[str, Family],
        *,
        law: Mapping[str, Any] | None = None,
        scenario: str = "",
        made_with: str = "",
    ):
        super().__init__(networks, outputs="change", scenario=scenario, made_with=made_with)
        for name, network in networks.items():
            widths = (len(FEATURES.get(name, ())), OUTPUTS.get(name, 0))
            if (network.n_in, network.n_out) != widths:
                raise PolicyError(
                    f"network {name} takes {network.n_in} figures and gives {network.n_out}; the law's figures make it "
                    f"{widths[0]} and {widths[1]} (kinds are {', '.join(FEATURES)})"
                )
        try:
            made = ModelAided(**(law or {}))
        except (TypeError, ValueError) as error:
            raise PolicyError(f"law is {law!r}: {error}") from None
        self.law: dict[str, Any] = dataclasses.asdict(made)
        self.corrects: np.ndarray | None = None
        """Rows in which the networks correct the law, bool, (row,); None for all."""

    def _begin(self, env_info: Scenario) -> None:
        self._law, self._past = ModelAided(**self.law), Past()
        self._law.reset(env_info)
        self._decided, self._rest = np.logical_or(*axes(env_info)), at_rest(env_info).astype(np.float32)
        for device in env_info.devices:
            if device.count and device.kind not in self.networks:
                raise PolicyError(
                    f"{self.source}: has no network for agents of kind {device.kind} of {env_info.name}, but "
                    f"{', '.join(self.networks)}"
                )
        self._interface_now()

    @property
    def interface(self) -> PolicyInterface:
        """PolicyError: its networks see figures of a law and not observations, and are bounded by themselves."""
        raise PolicyError(f"{self.source}: corrects the model-aided law, and sees its figures alone")

    def place(self, buses: np.ndarray) -> None:
        """Positions in ``bus_ids`` of the agents' buses, (row, n_agent), given after ``reset`` and before ``act``."""
        self._law.place(np.asarray(buses)[:, self._equipment.is_other])
        self._interface_now()

    def _interface_now(self) -> None:
        known = self._law.known
        self._corrected = None if known is None else LawInterface(self._law.site, known)

    def _joint(self, joint: np.ndarray) -> np.ndarray:
        if self._corrected is None:
            raise PolicyError(
                f"{self.source}: the data centres' buses are drawn in each episode; call place(buses) after reset with "
                "the agents' positions in bus_ids, (row, n_agent)"
            )
        rows = np.asarray(joint, dtype=np.float64).reshape(-1, joint.shape[-1])
        step, seen = self._corrected.figures(rows, self._past)
        outputs = {name: self.networks[name](inputs).astype(np.float64) for name, inputs in seen.items()}
        if self.corrects is not None:
            outputs = {name: output * self.corrects[:, None, None] for name, output in outputs.items()}
        action = np.tile(self._rest, (len(rows), 1))  # a site's other channels rest, as under the law
        action[:, self._decided] = self._corrected.action(step, outputs)
        return action.reshape(*joint.shape[:-1], action.shape[-1])

    def _about(self) -> dict[str, Any]:
        return {**super()._about(), "features": "law", "law": self.law}

    @classmethod
    def _read(cls, networks: Mapping[str, Family], about: Mapping[str, Any]) -> Policy:
        named = {"scenario": str(about["scenario"]), "made_with": str(about["made_with"])}
        return cls(networks, law=about["law"], **named)
