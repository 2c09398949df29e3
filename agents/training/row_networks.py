"""Policies from a network that acts on rows: the same weights, arranged for the agents of each kind."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dcgrid_env.agents.policy.neural_network import Network, PolicyError
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.training.row_views import AgentRows, ChannelRows, Rows


def policy_of_rows(rows: Rows, network: Network, *, scenario: str = "", made_with: str = "") -> Policy:
    """Return the policy that acts as a network does on rows: one network, or one for each kind of agent.

    Parameters
    ----------
    rows
        What a row is; its scenario defines what the agents observe.
    network
        Network from a row's observation to its action, without ``skip`` and ``scale``.
    scenario, made_with
        See :class:`Policy`.

    Raises
    ------
    PolicyError
        If the widths of the network are not those of the rows, or it has ``skip`` or ``scale``.
    """
    widths, needed = (network.n_in, network.n_out), (rows.n_observation, rows.n_action)
    if widths != needed:
        raise PolicyError(
            f"network takes {widths[0]} figures and gives {widths[1]}; rows have {needed[0]} and {needed[1]}"
        )
    if network.skip is not None or network.scale is not None:
        raise PolicyError("network has skip or scale; give one of layers alone")
    networks = {name: _of_kind(rows, network, name) for name in rows.members} if isinstance(rows, AgentRows) else {}
    sensing, form = rows.scenario.sensing, rows.form
    return Policy(
        networks or {"joint": _arranged(network, network.layers, None, rows.reach)},
        observe=sensing.observe, preview=sensing.preview, nameplate=form.nameplate,
        outputs=form.outputs, gains=form.gains, scenario=scenario, made_with=made_with,
        channels=rows.further_channels,
    )  # fmt: skip


def _of_kind(rows: AgentRows, network: Network, kind: str) -> Network:
    """Return the network of a kind of agents: without the inputs that are the same for all of them.

    These are the figures of the kind, the fields that it does not have, and the channel. The first bias contains them.
    If a row is a channel, each layer is repeated for each channel of the kind.
    """
    columns, entries = rows.columns(rows.scenario.agents[rows.members[kind][0]]), rows.entries(kind)
    (first, bias), *rest = network.layers
    observed, fixed = first[columns], [_normalised(network, row, columns) for row in rows.constant(kind)]
    biases = [(bias.astype(np.float64) + constant @ first).astype(np.float32) for constant in fixed]
    if not isinstance(rows, ChannelRows):
        layers = [(observed, biases[0]), *rest]
        last, last_bias = layers[-1]
        layers[-1] = (last[:, entries], last_bias[entries])
    else:
        n = len(biases)
        layers = [(np.tile(observed, n), np.concatenate(biases))]
        layers += [(np.kron(np.eye(n), weight), np.tile(b, n)) for weight, b in rest]
    return _arranged(network, layers, columns, rows.reach[entries])


def _normalised(network: Network, row: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return the first x of a network for a row, with 0 in these columns, (n_observation,)."""
    x = network.normalised(row)
    x[columns] = 0.0
    return x


def _arranged(
    network: Network, layers: Sequence[tuple[np.ndarray, np.ndarray]], columns: np.ndarray | None, reach: np.ndarray
) -> Network:
    """Return a network with these layers, which observes some columns of a row and gives what actions mean."""
    mean, std, clip = (
        array[..., columns] if columns is not None and isinstance(array, np.ndarray) else array
        for array in (network.mean, network.std, network.clip)
    )
    scale = None if (reach == 1.0).all() else reach
    return Network(layers, network.activation, network.squash, mean, std, clip, scale=scale)
