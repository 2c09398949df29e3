"""What SCADA reports of regulators to other agents: tap, deviation of the relay and timer, as shares.

The relay is out of band if its deviation is beyond -1 or 1. The timer is the time out of band as a share of the delay
before the first tap. After a tap it is the time since then, as a share of the delay between further taps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, namespace, take_last
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.devices.tap_changer.regulator_state import SAME_TIME_S, RegulatorState
from dcgrid_env.devices.tap_changer.relay import RelayBand, RelaySettings
from dcgrid_env.grid import ThreePhaseFeeder


class RegulatorView(NamedTuple):
    """Reported figures, (row, n_regulator) each."""

    tap: Array
    """Share of the farthest tap, -1 to 1."""
    relay: Array
    """Deviation of the relay volts from their target, in half bands."""
    timer: Array
    """Share of the delay that has passed, 0 to 1; 0 where the built-in control does not act."""


def regulator_view(settings: RelaySettings, band: RelayBand, state: RegulatorState) -> RegulatorView:
    """Return what is reported of regulators in some state, under the bands in force."""
    xp, zero = namespace(state.tap), 0.0 * state.tap
    farthest = xp.maximum(xp.maximum(xp.abs(settings.lowest), xp.abs(settings.highest)), 1.0 + 0.0 * settings.highest)
    delay_s = xp.where(state.in_sequence != 0.0, settings.tap_delay_s + zero, settings.delay_s + zero)
    return RegulatorView(
        tap=state.tap / farthest,
        relay=(state.relay_v - band.target_v) / band.half_band_v,
        timer=state.out_of_band_s / (delay_s + SAME_TIME_S),  # a tap is due within this time, also without a delay
    )


def upstream_view(feeder: ThreePhaseFeeder, view: RegulatorView) -> RegulatorView:
    """Return the figures of the regulator upstream of each node, (row, n_node) each; 0 where there is none."""
    xp, device = namespace(view.tap), view.tap.device
    regulator = xp.asarray(upstream_regulators(feeder), device=device)
    return RegulatorView(
        *(take_last(xp.concat((figures, 0.0 * figures[..., :1]), axis=-1), regulator) for figures in view)
    )


@cached_on_owner
def upstream_regulators(feeder: ThreePhaseFeeder) -> np.ndarray:
    """Return the row of the regulator nearest to each node on its phase's path to the source, int, (n_node,).

    It is the number of regulators for a node without one. A regulator is upstream of the bus that it feeds.
    """
    rows = np.full(feeder.n_node, feeder.n_regulator, np.int64)
    for node in range(feeder.n_node):
        upstream = node
        while upstream >= 0 and feeder.node_regulator[upstream] < 0:
            upstream = feeder.node_parent[upstream]
        if upstream >= 0:
            rows[node] = feeder.node_regulator[upstream]
    return rows
