"""Families of networks by the name that files have for them, and a network made of what a file says of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dcgrid_env.agents.policy.history_network import HistoryNetwork
from dcgrid_env.agents.policy.monotone import MonotoneNetwork
from dcgrid_env.agents.policy.neural_network import Family, Network, PolicyError

FAMILIES: dict[str, type[Family]] = {family.family: family for family in (Network, MonotoneNetwork, HistoryNetwork)}


def read_network(name: str, own: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Family:
    """Make a network of what a file says of it; PolicyError, naming it, for what cannot be one.

    Parameters
    ----------
    name
        Its name in the file, before a dot in the names of its arrays.
    own
        Its family and settings.
    arrays
        All arrays of the file.
    """
    settings = dict(own)
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
