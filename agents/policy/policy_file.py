"""The file of a policy: arrays and text in the safetensors format, which holds no code.

The arrays are ``NETWORK.ARRAY`` for each array of each network. Under ``KEY`` the metadata contain one JSON object:
version, kind, observe, preview, act, nameplate, scenario, made_with, and the networks with family and settings of each.
It also contains the SHA-256 of all that, which detects damage.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save

from dcgrid_env.agents.policy.neural_network import PolicyError
from dcgrid_env.core.user_files import parse_json, require_regular

KEY = "dcgrid policy"
"""The one key: safetensors writes several in any order, and the same policy is to be the same bytes."""
VERSION = 1
SUFFIX = ".safetensors"
MOST_MIB = 256
"""Largest file that is read."""


def packed(about: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> bytes:
    """The file's bytes."""
    text = json.dumps({"version": VERSION, **about, "sha256": digest(about, arrays)})
    return save({name: np.ascontiguousarray(array) for name, array in arrays.items()}, {KEY: text})


def unpacked(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What was packed.

    PolicyError if the file is not a policy, has an unknown version, is damaged or too large; OSError if it cannot be
    opened.
    """
    about, arrays = _contents(path)
    version, said = about.pop("version", None), about.pop("sha256", None)
    if version != VERSION:
        raise PolicyError(f"{path}: version is {version!r}, this dcgrid reads {VERSION}; export the policy again")
    if said != digest(about, arrays):
        raise PolicyError(f"{path}: its contents do not have the sha256 that it names; it is damaged, export it again")
    return about, arrays


def _contents(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What the metadata say, and the arrays."""
    size_mib = require_regular(path, PolicyError).st_size / 2**20
    if size_mib > MOST_MIB:
        raise PolicyError(f"{path}: has {size_mib:.0f} MiB; give a policy of at most {MOST_MIB} MiB")
    try:
        with safe_open(path, framework="numpy") as file:
            about = dict(parse_json(file.metadata()[KEY], KEY, PolicyError, ""))
            return about, {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (no mapping)
    except Exception:  # the header, types that NumPy has not and JSON each have errors of their own
        raise PolicyError(f"{path}: not a policy file; give one that Policy.save wrote") from None


def digest(about: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of metadata and arrays by value, whatever their order."""
    hashed = hashlib.sha256(json.dumps(about, sort_keys=True).encode())
    for name in sorted(arrays):
        array = arrays[name]
        hashed.update(f"{name}{array.shape}{array.dtype}".encode())
        hashed.update(np.ascontiguousarray(array).tobytes())
    return hashed.hexdigest()
