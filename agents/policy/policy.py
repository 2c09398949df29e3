"""Learned policies: small networks of NumPy arrays, run without the library that trained them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from sys import float_info
from typing import Any, TypeGuard

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.agents.policy.card import Card, card_of
from dcgrid_env.agents.policy.history_network import HistoryNetwork, outputs_of, remembers
from dcgrid_env.agents.policy.interface import ACTS, OUTPUTS, SCOPES, Gains, PolicyInterface
from dcgrid_env.agents.policy.monotone import MonotoneNetwork
from dcgrid_env.agents.policy.neural_network import Network, PolicyError
from dcgrid_env.agents.policy.policy_file import SUFFIX, digest, packed, unpacked
from dcgrid_env.agents.policy.unseen import warn_of_unseen
from dcgrid_env.baselines.equipment_agents import EquipmentAgents
from dcgrid_env.core.files import write_bytes
from dcgrid_env.core.suggestions import unknown

SET_POINTS = {"regulator_setpoint": "offset", "capacitor_setpoint": "centre"}
"""First channel of each kind of agent that chooses set points."""
SET_POINT_CHANNELS = ("offset", "half_band", "centre", "half_width")
"""All channels of these agents."""
Family = Network | MonotoneNetwork | HistoryNetwork
FAMILIES: dict[str, type[Family]] = {family.family: family for family in (Network, MonotoneNetwork, HistoryNetwork)}


def read_network(name: str, settings: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Family:
    """Create a network from the settings and arrays in a file; raise PolicyError with its name if they are invalid.

    Parameters
    ----------
    name
        Name of the network in the file; the names of its arrays begin with it and a dot.
    settings
        Family and settings of the network.
    arrays
        All arrays in the file.
    """
    settings = dict(settings)
    family = settings.pop("family")
    if family not in FAMILIES:
        raise PolicyError(f"{name}: family is {family!r}, this dcgrid reads {', '.join(FAMILIES)}")
    own_arrays = {key.removeprefix(f"{name}."): array for key, array in arrays.items() if key.startswith(f"{name}.")}
    try:
        return FAMILIES[family].read(own_arrays, settings)
    except KeyError as missing:
        raise PolicyError(f"{name}: {missing.args[0]} is missing; export the policy again") from None
    except PolicyError as error:
        raise PolicyError(f"{name}: {error}") from None


FOLDER = Path(__file__).parents[1] / "policies"
SHIPPED = tuple(sorted(path.stem for path in FOLDER.glob(f"*{SUFFIX}")))
"""Names of the bundled policies."""
OBSERVED = "observed"
"""Default network inputs, if a policy's file does not name others: the agent's observation."""
FORMS: dict[str, type[Policy]] = {}
"""Policy classes by the network inputs that files name; importing a module registers its class."""


class Policy:
    """Control with one network, or with one network for each kind of agent.

    Parameters
    ----------
    networks
        ``{"joint": network}`` maps the joint observation to the joint action of ``gymnasium.make``, for scenarios with
        the same numbers of agents. ``{"datacenter": network, "inverter": network, "storage": network}``, with the
        ``kind`` of a device as key, maps each agent's observation to its action in ``parallel_env``, with the device's
        channels in order. It fits any number of agents on any feeder, unless ``q_share`` is given. Regulators and
        capacitor banks need no network: their built-in control is used.
    observe
        Scope of observation in training.
    preview
        Whether the policy uses p_ref of the next interval. If not, these inputs are 0 in every scenario.
    act
        Controlled axes: ``both``, and all further channels; ``q``, with all clocks at their maximum; ``clock``, with
        all reactive set points at 0. With ``q`` or ``clock``, further channels keep their rest value.
    nameplate
        Whether each agent's observation ends with three further numbers. The first is r times the rating in MW, p_rated
        of a data centre or s_rated of an inverter. The second is x times the reactive limit at zero active power in
        Mvar. Both are in voltage bands. The third is v_deviation divided by the second and limited to +-3: the share of
        the agent's reactive power that would bring its voltage to 1. Without reactive power, the first is the divisor.
        A joint network has the first number of all agents, then the second, then the third.
    outputs
        Meaning of the network outputs: set points, changes from the action that keeps the current state, or corrections
        of a droop law or of a constant reactive power; see ``interface``.
    gains
        Gains of the droop law: k_p in MW/p.u., k_q in Mvar/(p.u. s), alpha in 1/s.
    q_share
        Constant share of the reactive limit of each agent with reactive power, -1 to 1, for ``outputs="constant"``.
    scenario
        Name of the training scenario.
    made_with
        Command that created the policy.
    channels
        Names of the output channels of a network, in order, and the same as in the scenario. Default: (clock, q) for a
        data centre and (q,) for an inverter; in a joint network all data centres, then all inverters.
    set_points
        Constant set points of regulators and capacitor banks that are agents without a network, by channel and bank,
        in the unit of the channel. Others keep the default. Banks that a scenario does not have are left out.

    Raises
    ------
    PolicyError
        If the names of the networks or a setting are invalid.
    """

    def __init_subclass__(cls, features: str) -> None:
        """Register the class for files that name these features."""
        FORMS[features] = cls

    def __init__(
        self,
        networks: Mapping[str, Family],
        *,
        observe: str = "local",
        preview: bool = True,
        act: str = "both",
        nameplate: bool = False,
        outputs: str = "setpoint",
        gains: Sequence[float] | None = None,
        q_share: Sequence[float] | None = None,
        scenario: str = "",
        made_with: str = "",
        channels: Mapping[str, Sequence[str]] | None = None,
        set_points: Mapping[str, Mapping[str, float]] | None = None,
    ):
        self.kind = "joint" if set(networks) == {"joint"} else "shared"
        if not networks or (self.kind == "shared" and not all(map(_is_kind, networks))):
            raise PolicyError(
                f"networks are {sorted(networks)}; give joint alone, or one for each kind of agent, such as "
                "datacenter, inverter and storage"
            )
        for field, value, choices in (("observe", observe, SCOPES), ("act", act, ACTS), ("outputs", outputs, OUTPUTS)):
            if value not in choices:
                raise PolicyError(f"{field} is {value!r}; choose one of {', '.join(choices)}")
        for field, value in (("preview", preview), ("nameplate", nameplate)):
            if not isinstance(value, bool):
                raise PolicyError(f"{field} is {value!r}; give true or false")
        self.networks = dict(networks)
        self.channels = {name: tuple(names) for name, names in (channels or {}).items()}
        for name, names in self.channels.items():
            if name not in networks or networks[name].n_out != len(names):
                gives = f"gives {networks[name].n_out}" if name in networks else "is not there"
                raise PolicyError(f"channels of {name} are {names}; the network {gives}: name each of its outputs")
        self.set_points = _checked_set_points({} if set_points is None else set_points)
        self.observe, self.preview, self.acts, self.nameplate = observe, preview, act, nameplate
        if (outputs == "droop") != (gains is not None):
            raise PolicyError(f"gains are {gains!r} and outputs {outputs!r}; give gains with droop and only there")
        self.q_share = _checked_shares(q_share, outputs)
        self.outputs, self.gains = outputs, None if gains is None else Gains.of(gains)
        self.trained_on = scenario
        self.made_with = made_with
        self.source = "policy"
        self.card: Card | None = None
        """Card of the policy, if the policy was read from a file with a card."""

    def reset(self, env_info: Scenario) -> None:
        """Begin episodes; raise PolicyError if the widths do not fit the scenario or an agent has no network."""
        if env_info.sensing.observe != self.observe:
            raise PolicyError(
                f"{self.source}: trained with observe={self.observe!r}, given {env_info.sensing.observe!r}"
            )
        self._equipment = self.equipment_agents(env_info)
        self._begin(self._equipment.others)

    def equipment_agents(self, scenario: Scenario) -> EquipmentAgents:
        """Return the driver of the equipment that has no network, with the constant set points."""
        return EquipmentAgents(scenario, keep_set_points=self.chooses_set_points, set_points=self.set_points)

    @property
    def chooses_set_points(self) -> bool:
        """Whether it has outputs for set points of regulators or capacitor banks; without, the defaults apply."""
        joint = self.channels.get("joint", ())
        return any(kind in self.networks for kind in SET_POINTS) or any(name in joint for name in SET_POINTS.values())

    def _begin(self, env_info: Scenario) -> None:
        """Begin episodes, with built-in control of regulators and capacitor banks."""
        chosen = {
            "preview": self.preview,
            "act": self.acts,
            "nameplate": self.nameplate,
            "outputs": self.outputs,
        }
        q_share = None if self.q_share is None else np.array(self.q_share, np.float32)
        self._interface = PolicyInterface(env_info, self.kind, gains=self.gains, q_share=q_share, **chosen)
        if q_share is not None and len(q_share) != len(self._interface.q_agents):
            raise PolicyError(
                f"{self.source}: has {len(q_share)} constant shares of reactive power; {env_info.name} has "
                f"{len(self._interface.q_agents)} agents with reactive power; train one for this scenario"
            )
        for name in self._interface.widths:
            self._check_fits(name, self._interface, env_info)
        self._memory: dict[str, tuple[np.ndarray, ...]] = {}
        self._batch_shape: tuple[int, ...] | None = None
        warn_of_unseen(self.source, self.trained_on, env_info)

    def _check_fits(self, name: str, view: PolicyInterface, scenario: Scenario) -> None:
        """Raise PolicyError unless the network exists and has the widths and channels of the scenario's agents."""
        widths, channels = view.widths[name], view.channels[name]
        trained = f"it was trained on {self.trained_on or 'another'}; train one for this scenario"
        if name not in self.networks:
            has = ", ".join(self.networks)
            raise PolicyError(
                f"{self.source}: has no network for agents of kind {name} of {scenario.name}, but {has}; {trained}"
            )
        network = self.networks[name]
        counts = ", ".join(f"{device.count} of kind {device.kind}" for device in scenario.devices if device.count)
        if (network.n_in, network.n_out) != widths:
            raise PolicyError(
                f"{self.source}: network {name} takes {network.n_in} figures and gives {network.n_out}, on "
                f"{scenario.name} ({counts}, {scenario.sensing.observe} observation) it must be {widths[0]} and "
                f"{widths[1]}; {trained}"
            )
        given_channels = self.channels.get(name, view.plain_channels[name])
        if given_channels != channels:
            raise PolicyError(
                f"{self.source}: network {name} gives {', '.join(given_channels)}; on {scenario.name} its agents take "
                f"{', '.join(channels)}; {trained}"
            )

    def act(self, observations: Any) -> Any:
        """Return actions in the form of the observations: a mapping of agents, or joint, (..., n_observation)."""
        return self._equipment.act(observations, self._joint)

    def _joint(self, joint: np.ndarray) -> np.ndarray:
        if self.remembers:
            shape = joint.shape[:-1]
            if self._batch_shape not in (None, shape):
                raise PolicyError(
                    f"{self.source}: remembers episodes of shape {self._batch_shape} and is given observations of "
                    f"shape {shape}; call reset(scenario) where other episodes begin, and give all environments at "
                    "each step"
                )
            self._batch_shape = shape
        outputs = outputs_of(self.networks, self._interface.inputs(joint), self._memory)
        return self._interface.action(joint, outputs)

    @property
    def remembers(self) -> bool:
        """Whether actions depend on earlier observations. If so, ``reset`` begins the episodes of all environments."""
        return any(map(remembers, self.networks.values()))

    def probe(self, joint: np.ndarray) -> np.ndarray:
        """Return the joint action for a joint observation without equipment; the observation is not remembered."""
        outputs = outputs_of(self.networks, self._interface.inputs(joint), dict(self._memory))
        return self._interface.action(joint, outputs)

    @property
    def interface(self) -> PolicyInterface:
        """Interface between the networks and the scenario of the last ``reset``."""
        return self._interface

    @property
    def sha256(self) -> str:
        """Hash of weights and settings."""
        return digest(self._about(), self._arrays())

    @property
    def n_parameters(self) -> int:
        """Number of parameters in all arrays."""
        return sum(array.size for array in self._arrays().values())

    def _arrays(self) -> dict[str, np.ndarray]:
        return {f"{name}.{key}": array for name, net in self.networks.items() for key, array in net.arrays().items()}

    def _about(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "observe": self.observe,
            "preview": self.preview,
            "act": self.acts,
            "nameplate": self.nameplate,
            "outputs": self.outputs,
            "scenario": self.trained_on,
            "made_with": self.made_with,
            "networks": {name: {"family": net.family, **net.settings()} for name, net in self.networks.items()},
            **({} if self.gains is None else {"gains": list(self.gains)}),
            **({} if self.q_share is None else {"q_share": list(self.q_share)}),
            **({"channels": {name: list(names) for name, names in self.channels.items()}} if self.channels else {}),
            **({"set_points": self.set_points} if self.set_points else {}),
        }

    def save(self, path: str | Path, card: Mapping[str, Any] | None = None) -> Path:
        """Write weights and card, each atomically, and create missing folders.

        Parameters
        ----------
        path
            File of the weights, with or without the suffix ``.safetensors``; the card has the suffix ``.json``.
        card
            Origin of the policy (``card.ORIGIN_FIELDS``). Scenario and command default to those of the policy.

        Returns
        -------
        Path
            File of the weights.

        Raises
        ------
        PolicyError
            If the suffix or the card is invalid.
        """
        path = Path(path)
        if path.suffix not in ("", SUFFIX):
            raise PolicyError(f"{path}: a policy's file name ends in {SUFFIX}")
        path = path.with_suffix(SUFFIX)
        about = {"scenario": self.trained_on, "command": self.made_with} | dict(card or {})
        beside = Card.of(self.sha256, self.n_parameters, about)
        write_bytes(path, packed(self._about(), self._arrays()))
        beside.save(path.with_suffix(".json"))
        return path

    @classmethod
    def _read(cls, networks: Mapping[str, Family], about: Mapping[str, Any]) -> Policy:
        """Return the policy with these networks and the data of ``_about``; raise KeyError if data are missing."""
        chosen: dict[str, Any] = {key: about[key] for key in ("observe", "preview", "act", "nameplate", "outputs")}
        chosen |= {"scenario": str(about["scenario"]), "made_with": str(about["made_with"])}
        chosen |= {key: about.get(key) for key in ("gains", "q_share", "channels", "set_points")}
        return cls(networks, **chosen)

    @classmethod
    def load(cls, name_or_path: str | Path) -> Policy:
        """Read a bundled policy by name (``SHIPPED``), or a file, with its card if there is one.

        Raises PolicyError if the file is not a policy, has an unknown version, is damaged or too large, or if its card
        is invalid or belongs to another policy. Raises OSError if the file cannot be opened.
        """
        if str(name_or_path) in SHIPPED:
            policy = _load(FOLDER / f"{name_or_path}{SUFFIX}")
            policy.source = str(name_or_path)
            return policy
        path = Path(name_or_path)
        if path.suffix != SUFFIX:
            raise PolicyError(unknown("policy", str(path), SHIPPED, "`dcgrid list controllers` lists all"))
        return _load(path)


FORMS[OBSERVED] = Policy


def _checked_shares(q_share: object, outputs: str) -> tuple[float, ...] | None:
    """Return constant shares of the reactive limit; raise PolicyError if they are invalid or the outputs need none."""
    if (outputs == "constant") != (q_share is not None):
        raise PolicyError(f"q_share is {q_share!r} and outputs {outputs!r}; give q_share with constant and only there")
    if q_share is None:
        return None
    if not isinstance(q_share, Sequence) or not all(_is_number(share) and abs(share) <= 1.0 for share in q_share):
        raise PolicyError(f"q_share is {q_share!r}; give one number from -1 to 1 for each agent with reactive power")
    return tuple(map(float, q_share))


def _checked_set_points(set_points: object) -> dict[str, dict[str, float]]:
    """Return constant set points by channel and bank; raise PolicyError unless they are such."""
    if not isinstance(set_points, Mapping) or not all(isinstance(banks, Mapping) for banks in set_points.values()):
        raise PolicyError(
            f"set_points are {set_points!r}; give a mapping from channels to mappings from banks to numbers"
        )
    for channel, of_banks in set_points.items():
        if channel not in SET_POINT_CHANNELS:
            raise PolicyError(f"set_points have the channel {channel!r}; choose from {', '.join(SET_POINT_CHANNELS)}")
        for bank, value in of_banks.items():
            if not _is_number(value) or not abs(value) <= float_info.max:
                raise PolicyError(f"set_points of {bank}: {channel} is {value!r}; give a finite number")
    return {channel: dict(of_banks) for channel, of_banks in set_points.items()}


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_kind(name: str) -> bool:
    """Return whether a name is a valid kind of agent; it must not contain a dot, which ends it in a file."""
    return name not in ("", "joint") and "." not in name


def _load(path: Path) -> Policy:
    about, arrays = unpacked(path)
    try:
        networks = {name: read_network(name, settings, arrays) for name, settings in about["networks"].items()}
        for array in arrays:
            if array.partition(".")[0] not in networks:
                raise PolicyError(f"array {array} belongs to none of its networks; export it again")
        form = FORMS.get(about.get("features", OBSERVED))
        if form is None:
            raise PolicyError(f"features are {about['features']!r}, this dcgrid reads {', '.join(FORMS)}")
        policy = form._read(networks, about)
    except KeyError as missing:
        raise PolicyError(f"{path}: {missing.args[0]} is missing; export the policy again") from None
    except (PolicyError, TypeError, AttributeError) as error:
        raise PolicyError(f"{path}: {error}") from None
    if about.get("kind") != policy.kind:
        raise PolicyError(
            f"{path}: kind is {about.get('kind')!r}, its networks are {sorted(networks)}; export it again"
        )
    policy.source = str(path)
    policy.card = card_of(path, policy)
    return policy
