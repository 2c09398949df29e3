"""Faults and sags of an episode as drawn, and what of the sags falls into an interval."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core import random
from dcgrid_env.scenario.scenario import Scenario

FOR_GOOD = 2**40
"""Steps that outlast every episode."""


def drawn_faults(scenario: Scenario, key: np.ndarray) -> np.ndarray:
    """What is lost, from which step on and to which, int64, (row, n_fault, 3)."""
    drawn = random.bits(key, random.FAULT, 3 * len(scenario.faults)).reshape(len(key), -1, 3)
    struck = np.empty(drawn.shape, np.int64)

    def steps(times_s: tuple[float, float], between: np.ndarray) -> np.ndarray:
        low, high = (round(min(t_s / scenario.dt_s, FOR_GOOD)) for t_s in times_s)
        return low + (between % np.uint64(high - low + 1)).astype(np.int64)

    for i, (fault, targets) in enumerate(zip(scenario.faults, scenario.fault_targets, strict=True)):
        struck[:, i, 0] = targets[drawn[:, i, 0] % np.uint64(len(targets))]
        struck[:, i, 1] = 1 + steps(fault.begin_s, drawn[:, i, 1])  # nothing is lost at t = 0
        struck[:, i, 2] = struck[:, i, 1] + steps(fault.duration_s, drawn[:, i, 2])
    return struck


def drawn_sags(scenario: Scenario, key: np.ndarray) -> np.ndarray:
    """Beginning, s from the episode's, duration, s, and share left of each sag, in time, (row, n_sag, 3)."""
    sags = scenario.sags
    part = random.uniform(key, random.SAG, 3 * len(sags)).reshape(len(key), -1, 3)
    ranges = np.array([(sag.begin_s, sag.duration_s, sag.retained_pu) for sag in sags]).reshape(-1, 3, 2)
    drawn = ranges[..., 0] + part * (ranges[..., 1] - ranges[..., 0])
    for i, sag in enumerate(sags):
        if sag.since == "previous":
            drawn[:, i, 0] += drawn[:, i - 1, 0]
    order = np.argsort(drawn[..., 0], axis=1, kind="stable")
    return np.take_along_axis(drawn, order[..., None], axis=1)


def sags_in_interval(scenario: Scenario, sag: np.ndarray, step: np.ndarray) -> np.ndarray | None:
    """The sags as devices are given them (``connection.Supply``) in the interval that ends at ``step`` (row,).

    (row, n_sag, 3), the duration 0 where one does not begin in it; None in a scenario without sags.
    """
    if not scenario.sags:
        return None
    begin_s = sag[..., 0]
    begins = np.floor(begin_s / scenario.dt_s) == step[:, None] - 1
    if not begins.any():
        return np.zeros(sag.shape)
    duration_s, retained = sag[..., 1], sag[..., 2]
    rest_s = np.clip(step[:, None] * scenario.dt_s - begin_s, 0.0, scenario.dt_s)
    return np.stack((begins * duration_s, retained, rest_s), axis=-1)
