"""Learned policies as files: small networks of NumPy arrays, run without the library that trained them.

A file is what ``numpy.savez`` writes, loaded without pickle, so that loading never runs code. It holds the arrays
``NETWORK.w0, NETWORK.b0, NETWORK.w1, ..`` and, where observations are normalised, ``NETWORK.mean, NETWORK.std``, and
``meta``, JSON in UTF-8 as bytes: format, version, kind, observe, scenario, made_with, and for each network its number
of layers, activation, squash and clip.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env import Scenario, field_names
from dcgrid_env.baselines.network import Network, PolicyError

__all__ = ["Network", "Policy", "PolicyError", "load_policy", "save_policy"]

FORMAT = "dcgrid policy"
VERSION = 1
SCOPES = ("local", "neighbours", "feeder")
MOST_MIB = 256
"""Largest policy that is read, unpacked."""
KINDS = {"joint": ("joint",), "shared": ("datacenter", "inverter")}
"""Networks of each kind of policy: one for all agents together, or one for each kind of agent."""


class Policy:
    """A controller that is one network, or one for each kind of agent.

    Parameters
    ----------
    networks
        ``{"joint": network}``: from the joint observation to the joint action, as ``gymnasium.make`` has them; fits
        scenarios with the same numbers of agents. Or ``{"datacenter": network, "inverter": network}``: from each
        agent's own observation to its own action, (clock, q) or (q,), as ``parallel_env`` has them; fits any number of
        agents on any feeder. One of the two may be left out where there is no such agent.
    observe
        Scope of observation that it was trained with.
    scenario
        Name of the scenario that it was trained on.
    made_with
        The command that made it.

    Raises
    ------
    PolicyError
        For networks of neither kind, or whose outputs are not the agent's actions.
    """

    def __init__(
        self, networks: Mapping[str, Network], *, observe: str = "local", scenario: str = "", made_with: str = ""
    ):
        self.kind = next((kind for kind, names in KINDS.items() if networks and set(networks) <= set(names)), "")
        if not self.kind:
            raise PolicyError(f"networks are {sorted(networks)}; give joint alone, or datacenter, inverter or both")
        if observe not in SCOPES:
            raise PolicyError(f"observe is {observe!r}; choose one of {', '.join(SCOPES)}")
        for name, want in (("datacenter", 2), ("inverter", 1)):
            if name in networks and networks[name].n_out != want:
                raise PolicyError(f"{name}: the network has {networks[name].n_out} outputs; its agents take {want}")
        self.networks = dict(networks)
        self.observe = observe
        self.trained_on = scenario
        self.made_with = made_with
        self.source = "policy"

    def reset(self, env_info: Scenario) -> None:
        """Begin episodes; PolicyError where the widths do not fit the scenario, or it has agents without a network."""
        names = field_names(env_info)
        n_dc, n_inv = env_info.n_datacenters, env_info.n_inverters
        widths = [len(names[agent]) for agent in env_info.agents]
        self._agents, self._n_dc = env_info.agents, n_dc
        self._cuts = np.cumsum([2] * n_dc + [1] * n_inv)[:-1]
        self._split_at = sum(widths[:n_dc])
        if env_info.observe != self.observe:
            raise PolicyError(f"{self.source}: trained with observe={self.observe!r}, given {env_info.observe!r}")
        if self.kind == "joint":
            needed = {"joint": (sum(widths), 2 * n_dc + n_inv)}
        else:
            needed = {"datacenter": (widths[0], 2)} if n_dc else {}
            needed |= {"inverter": (widths[-1], 1)} if n_inv else {}
        for name, (n_in, n_out) in needed.items():
            if name not in self.networks:
                raise PolicyError(f"{self.source}: has no network for the {name}s of {env_info.name}; train one")
            network = self.networks[name]
            if (network.n_in, network.n_out) != (n_in, n_out):
                raise PolicyError(
                    f"{self.source}: network {name} takes {network.n_in} figures and gives {network.n_out}, on "
                    f"{env_info.name} it must be {n_in} and {n_out}; it was trained on {self.trained_on or 'another'}"
                )

    def act(self, observations: Any) -> Any:
        """Actions for observations, in the same form: a mapping of agents, or joint, (..., n_observation)."""
        if isinstance(observations, Mapping):
            joint = np.concatenate([observations[agent] for agent in self._agents], axis=-1)
            return dict(zip(self._agents, np.split(self._joint(joint), self._cuts, axis=-1), strict=True))
        return self._joint(np.asarray(observations))

    def _joint(self, joint: np.ndarray) -> np.ndarray:
        if self.kind == "joint":
            return self.networks["joint"](joint)
        lead, own = joint.shape[:-1], []
        parts = (joint[..., : self._split_at], joint[..., self._split_at :])
        counts = (self._n_dc, len(self._agents) - self._n_dc)
        for name, part, count in zip(KINDS["shared"], parts, counts, strict=True):
            if count:
                each = part.reshape(*lead, count, part.shape[-1] // count)
                own.append(self.networks[name](each).reshape(*lead, -1))
        return np.concatenate(own, axis=-1)


def save_policy(path: str | Path, policy: Policy) -> None:
    """Write a policy, whole or not at all; folders are made. PolicyError unless the name ends in .npz."""
    path = Path(path)
    if path.suffix != ".npz":
        raise PolicyError(f"{path}: a policy's file name ends in .npz")
    arrays: dict[str, Any] = {}
    about: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "kind": policy.kind,
        "observe": policy.observe,
        "scenario": policy.trained_on,
        "made_with": policy.made_with,
        "networks": {},
    }
    for name, network in policy.networks.items():
        for i, (weight, bias) in enumerate(network.layers):
            arrays |= {f"{name}.w{i}": weight, f"{name}.b{i}": bias}
        arrays |= {
            f"{name}.{key}": getattr(network, key) for key in ("mean", "std") if getattr(network, key) is not None
        }
        own = {key: getattr(network, key) for key in ("activation", "squash", "clip")}
        about["networks"][name] = {"layers": len(network.layers), **own}
    arrays["meta"] = np.frombuffer(json.dumps(about).encode(), np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    with part.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
    part.replace(path)


def load_policy(path: str | Path) -> Policy:
    """Read a policy.

    PolicyError for what is none, of an unknown version, broken or too large; OSError if it cannot be opened.
    """
    path = Path(path)
    about, arrays = _contents(path)
    if about.get("version") != VERSION:
        raise PolicyError(
            f"{path}: version is {about.get('version')!r}, this dcgrid reads {VERSION}; export the policy again"
        )
    try:
        networks = {name: _network(name, own, arrays) for name, own in about["networks"].items()}
        policy = Policy(
            networks, observe=about["observe"], scenario=str(about["scenario"]), made_with=str(about["made_with"])
        )
    except KeyError as missing:
        raise PolicyError(f"{path}: {missing.args[0]} is missing; export the policy again") from None
    except (PolicyError, TypeError, AttributeError) as error:
        raise PolicyError(f"{path}: {error}") from None
    if about.get("kind") != policy.kind:
        raise PolicyError(
            f"{path}: kind is {about.get('kind')!r}, its networks are {sorted(networks)}; export it again"
        )
    policy.source = str(path)
    return policy


def _contents(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What ``meta`` says, and the other arrays."""
    about: dict[str, Any] = {}
    arrays: dict[str, np.ndarray] = {}
    with path.open("rb") as raw:
        try:
            with zipfile.ZipFile(raw) as packed:
                size_mib = sum(member.file_size for member in packed.infolist()) / 2**20
            if size_mib > MOST_MIB:
                raise PolicyError(f"{path}: unpacks to {size_mib:.0f} MiB; give a policy of at most {MOST_MIB} MiB")
            raw.seek(0)
            with np.load(raw, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            about = json.loads(arrays.pop("meta").tobytes())
            known = about["format"] == FORMAT
        except PolicyError:
            raise
        except Exception:  # zip, its ways of packing, the arrays' headers and JSON each have errors of their own
            known = False
    if not known:
        raise PolicyError(f"{path}: not a policy file; give one that save_policy wrote")
    return about, arrays


def _network(name: str, own: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Network:
    layers = [(arrays[f"{name}.w{i}"], arrays[f"{name}.b{i}"]) for i in range(own["layers"])]
    try:
        return Network(
            layers, own["activation"], own["squash"], arrays.get(f"{name}.mean"), arrays.get(f"{name}.std"), own["clip"]
        )
    except PolicyError as error:
        raise PolicyError(f"{name}: {error}") from None
