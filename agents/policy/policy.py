"""Learned policies: small networks of NumPy arrays, run without the library that trained them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.agents.policy.card import Card, card_of
from dcgrid_env.agents.policy.history_network import HistoryNetwork
from dcgrid_env.agents.policy.interface import ACTS, OUTPUTS, SCOPES, Gains, PolicyInterface
from dcgrid_env.agents.policy.memory import Remembers, outputs_of, require_same_episodes
from dcgrid_env.agents.policy.monotone import MonotoneNetwork
from dcgrid_env.agents.policy.neural_network import Family, Network, PolicyError
from dcgrid_env.agents.policy.policy_file import SUFFIX, digest, packed, unpacked
from dcgrid_env.agents.policy.unseen import warn_of_unseen
from dcgrid_env.baselines.equipment_agents import EquipmentAgents
from dcgrid_env.core.files import write_bytes
from dcgrid_env.core.suggestions import unknown

FAMILIES: dict[str, type[Family]] = {family.family: family for family in (Network, MonotoneNetwork, HistoryNetwork)}


def read_network(name: str, settings: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Family:
    """Make a network of what a file says of it; PolicyError, naming it, for what cannot be one.

    Parameters
    ----------
    name
        Its name in the file, before a dot in the names of its arrays.
    settings
        Its family and settings.
    arrays
        All arrays of the file.
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
"""Names of the policies that ship."""
OBSERVED = "observed"
"""What a policy's networks see of an agent, where its file says nothing else: the observation."""
FORMS: dict[str, type[Policy]] = {}
"""Forms of policies by what their networks see, as files name it; each is there once its module is imported."""


class Policy:
    """A controller that is one network, or one for each kind of agent.

    Parameters
    ----------
    networks
        ``{"joint": network}``: from the joint observation to the joint action, as ``gymnasium.make`` has them; fits
        scenarios with the same numbers of agents. Or one for each kind of agent, by the ``kind`` of its device,
        ``{"datacenter": network, "inverter": network, "storage": network}``: from each agent's own observation to its
        own action, its device's channels in order, as ``parallel_env`` has them; fits any number of agents on any
        feeder. Regulators and capacitor banks need none: they stay under their own control.
    observe
        Scope of observation that it was trained with.
    preview
        Whether it sees the coming interval's p_ref; if not, those fields are 0 for it whatever the scenario shows.
    act
        Which axes it moves: ``both``, and all further channels; ``q``, with every clock at the top; ``clock``, with all
        reactive setpoints at 0. With one axis alone further channels stay at rest.
    nameplate
        Whether an agent's observation has three more figures at its end: r times its rating in MW (of a data centre
        p_rated, of an inverter s_rated) and x times its reactive limit at zero active power in Mvar, both in bands of
        voltage, and v_deviation over the latter, cut to +-3: the share of its reactive power that would bring its own
        voltage to 1; where it has no reactive power, v_deviation over the first. A joint network has the first of all
        agents, then the second, then the third.
    outputs
        Whether the networks give setpoints, changes of what holds everything as it is, or corrections of a droop law,
        see ``interface``.
    gains
        Gains of that law: k_p, MW per p.u., k_q, Mvar per p.u. and s, and alpha, per s.
    scenario
        Name of the scenario that it was trained on.
    made_with
        The command that made it.
    channels
        Names of the channels that a network gives, in order, for networks that give something else than (clock, q) for
        a data centre and (q,) for an inverter, a joint one for all data centres and then all inverters. A scenario's
        must be the same.

    Raises
    ------
    PolicyError
        For networks of neither kind, or settings that there are not.
    """

    def __init_subclass__(cls, features: str) -> None:
        """Have a file that names these features read as a policy of this form."""
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
        scenario: str = "",
        made_with: str = "",
        channels: Mapping[str, Sequence[str]] | None = None,
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
        self.observe, self.preview, self.acts, self.nameplate = observe, preview, act, nameplate
        if (outputs == "droop") != (gains is not None):
            raise PolicyError(f"gains are {gains!r} and outputs {outputs!r}; give gains with droop and only there")
        self.outputs, self.gains = outputs, None if gains is None else Gains.of(gains)
        self.trained_on = scenario
        self.made_with = made_with
        self.source = "policy"
        self.card: Card | None = None
        """Card of the policy, if it was read from a file with a card."""

    def reset(self, env_info: Scenario) -> None:
        """Begin episodes; PolicyError where the widths do not fit the scenario, or it has agents without a network."""
        if env_info.sensing.observe != self.observe:
            raise PolicyError(
                f"{self.source}: trained with observe={self.observe!r}, given {env_info.sensing.observe!r}"
            )
        self._equipment = EquipmentAgents(env_info)
        self._begin(self._equipment.others)

    def _begin(self, env_info: Scenario) -> None:
        """Begin episodes, regulators and capacitor banks under their own control."""
        chosen = {
            "preview": self.preview,
            "act": self.acts,
            "nameplate": self.nameplate,
            "outputs": self.outputs,
        }
        chosen["gains"] = self.gains
        self._interface = PolicyInterface(env_info, self.kind, **chosen)
        for name in self._interface.widths:
            self._check_fits(name, self._interface, env_info)
        self._memory: dict[str, tuple[np.ndarray, ...]] = {}
        self._batch_shape: tuple[int, ...] | None = None
        warn_of_unseen(self.source, self.trained_on, env_info)

    def _check_fits(self, name: str, view: PolicyInterface, scenario: Scenario) -> None:
        """PolicyError unless there is a network of this name, with the widths and channels of the scenario's agents."""
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
        """Actions for observations, in the same form: a mapping of agents, or joint, (..., n_observation)."""
        return self._equipment.act(observations, self._joint)

    def _joint(self, joint: np.ndarray) -> np.ndarray:
        if self.remembers:
            self._batch_shape = require_same_episodes(self.source, self._batch_shape, joint.shape[:-1])
        outputs = outputs_of(self.networks, self._interface.inputs(joint), self._memory)
        return self._interface.action(joint, outputs)

    @property
    def remembers(self) -> bool:
        """Whether actions depend on earlier observations: if so, ``reset`` begins the episodes of all environments."""
        return any(isinstance(network, Remembers) for network in self.networks.values())

    def probe(self, joint: np.ndarray) -> np.ndarray:
        """The joint action for a joint observation of all but the equipment, which is not remembered."""
        outputs = outputs_of(self.networks, self._interface.inputs(joint), dict(self._memory))
        return self._interface.action(joint, outputs)

    @property
    def interface(self) -> PolicyInterface:
        """What stands between its networks and the scenario that it was reset with."""
        return self._interface

    @property
    def sha256(self) -> str:
        """Hash of weights and settings."""
        return digest(self._about(), self._arrays())

    @property
    def n_parameters(self) -> int:
        """Figures in its arrays."""
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
            **({"channels": {name: list(names) for name, names in self.channels.items()}} if self.channels else {}),
        }

    def save(self, path: str | Path, card: Mapping[str, Any] | None = None) -> Path:
        """Write weights and card, each whole or not at all; folders are made.

        Parameters
        ----------
        path
            File of the weights, with ``.safetensors`` at its end or without; the card has ``.json`` there.
        card
            How it was made (``card.ORIGIN_FIELDS``); scenario and command are the policy's own unless given.

        Returns
        -------
        Path
            File of the weights.

        Raises
        ------
        PolicyError
            For another suffix, or a card that cannot be.
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
        """The policy of these networks and what ``_about`` said; KeyError for what is missing."""
        chosen: dict[str, Any] = {key: about[key] for key in ("observe", "preview", "act", "nameplate", "outputs")}
        chosen |= {"scenario": str(about["scenario"]), "made_with": str(about["made_with"])}
        return cls(networks, **chosen, gains=about.get("gains"), channels=about.get("channels"))

    @classmethod
    def load(cls, name_or_path: str | Path) -> Policy:
        """Read a policy that ships, by its name (``SHIPPED``), or a file, with its card where it has one.

        PolicyError for what is none, of an unknown version, broken or too large, and for a card that is none or is of
        another policy; OSError if it cannot be opened.
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


def _is_kind(name: str) -> bool:
    """Whether a network may have this name beside others: that of a kind, without the dot that ends it in a file."""
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
