"""Family of training scenarios on random feeders; a split and a number identify a scenario.

Each scenario of a split has a different feeder (``random_feeder``). The number, location and size of data centres and
inverters, the substation voltage, the load fluctuation and the work are also random. Ratings are relative to the
feeder's load, so small feeders have small devices. Splits have no scenario in common.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env import Feeder, FeederError, Scenario, make_scenario, random_feeder

FAMILY = "drawn-feeders"
"""Training scenario in the files of policies that were trained on the family."""
_SALT = {"train": 1, "validation": 2}
_STYLES = {"us-mv": 0.7, "rural": 0.25, "urban": 0.05}
_TRACES = {"inference": 0.55, "code": 0.2, "mixed": 0.25}
_LARGEST_FEEDERS = 1 << 32


def drawn_scenario(split: str, i: int) -> Scenario:
    """Return scenario i of a split, ``train`` or ``validation``, with the traces and episodes of that split."""
    rng = np.random.default_rng([16, _SALT[split], i])
    n_bus = round(float(np.exp(rng.uniform(np.log(16), np.log(130)))))
    load_kw = float(np.exp(rng.uniform(np.log(1500.0), np.log(9000.0))))
    style = str(rng.choice(list(_STYLES), p=list(_STYLES.values())))
    feeder, load_kw = _feeder(load_kw, int(rng.integers(_LARGEST_FEEDERS)), n_bus, style)
    n_dc, n_inv = int(rng.integers(1, 7)), int(rng.integers(2, 9))
    buses = rng.choice(_loaded(feeder), n_dc + n_inv, replace=False)
    sun = rng.random() < 0.2
    sites_kw = load_kw * rng.uniform(0.3, 1.2) * _parts(rng, n_dc)
    kva = load_kw * np.exp(rng.uniform(np.log(0.1), np.log(1.0))) * (2.5 if sun else 1.0) * _parts(rng, n_inv)
    return make_scenario("ieee33").replace(
        name=f"drawn-{split}-{i}",
        feeder=feeder,
        source_voltage_pu=float(rng.uniform(1.0, 1.05)),
        n_datacenters=n_dc,
        datacenters={
            "buses": tuple(feeder.bus_ids[bus] for bus in buses[:n_dc]),
            "p_rated_kw": tuple(sites_kw),
            "s_rated_share": float(rng.uniform(1.02, 1.1)),
        },
        inverters={
            "buses": tuple(feeder.bus_ids[bus] for bus in buses[n_dc:]),
            "s_rated_kva": tuple(kva),
            "injection": "pv" if sun else None,
        },
        trace=str(rng.choice(list(_TRACES), p=list(_TRACES.values()))),
        workload={"site_correlation": float(rng.random() < 0.15)},
        background={"load_sigma": float(rng.uniform(0.02, 0.08))},
        split=split,
    )


def _feeder(load_kw: float, seed: int, n_bus: int, style: str) -> tuple[Feeder, float]:
    """Draw a feeder of a load, or of the style's own load if it has no such feeder on so many buses; and the load."""
    try:
        return random_feeder(seed, n_bus=n_bus, style=style, load_kw=load_kw), load_kw
    except FeederError:
        feeder = random_feeder(seed, n_bus=n_bus, style=style)
        return feeder, float(np.sum(feeder.p_load_kw))


def _loaded(feeder: Feeder) -> np.ndarray:
    """Return the positions of buses with a load, at least as many as devices may be placed at."""
    load_kw = np.asarray(feeder.p_load_kw)
    buses = np.flatnonzero(load_kw > 0)
    buses = buses[buses > 0]
    return buses if len(buses) >= 14 else np.arange(1, len(load_kw))


def _parts(rng: np.random.Generator, n: int) -> np.ndarray:
    """Shares of n devices, which add up to 1, none above three times another."""
    weights = np.exp(rng.uniform(0.0, np.log(3.0), n))
    return weights / weights.sum()
