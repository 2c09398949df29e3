"""A radial feeder drawn at random with the statistics of published ones."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.seeds import whole_seed
from dcgrid_env.core.suggestions import unknown
from dcgrid_env.grid.feeder import Feeder
from dcgrid_env.grid.random_feeders.drawn import DrawnFeeder, draw_feeder
from dcgrid_env.grid.random_feeders.styles import STYLES, own_buses
from dcgrid_env.grid.random_feeders.tree import Tree
from dcgrid_env.grid.topology import FeederError

_HEADINGS = 16
_HALF_TURN = np.array([1.0, 0.923880, 0.707107, 0.382683, 0.0, -0.382683, -0.707107, -0.923880])
_COSINES = np.concatenate((_HALF_TURN, -_HALF_TURN))
_SIDE = 4  # a right angle


def positions_km(tree: Tree, length_km: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of the buses, km from the substation, (n_bus,) each, to the metre.

    Branches have their lengths; they may cross, as the tree has no map.
    """
    n = len(tree.parent) + 1
    x, y, heading = np.zeros(n), np.zeros(n), np.zeros(n, np.intp)
    departures = max(1, int((tree.parent == 0).sum()))
    of_chain: dict[int, int] = {}
    for k, (fed_by, chain) in enumerate(zip(tree.parent.tolist(), tree.chain.tolist(), strict=True)):
        if chain not in of_chain:
            if fed_by == 0:
                of_chain[chain] = chain * max(1, _HEADINGS // departures) % _HEADINGS
            else:
                of_chain[chain] = (int(heading[fed_by]) + (_SIDE if len(of_chain) % 2 else -_SIDE)) % _HEADINGS
        heading[k + 1] = of_chain[chain]
        x[k + 1] = x[fed_by] + length_km[k] * _COSINES[heading[k + 1]]
        y[k + 1] = y[fed_by] + length_km[k] * _COSINES[(heading[k + 1] - _SIDE) % _HEADINGS]
    return np.round(x, 3), np.round(y, 3)


MOST_BUSES = 100_000
LEAST_BUSES = 10


def random_feeder(seed: int, *, n_bus: int = 60, style: str = "urban", load_kw: float | None = None) -> Feeder:
    """Draw a radial feeder; the same arguments give the same one on every machine.

    Its power flow has a solution at twice its loads, and the drop to its lowest bus is in the range of its style. Its
    conductors carry their current at peak and grow towards the substation. It has coordinates.
    docs/random-feeders.md compares it with published feeders.

    Parameters
    ----------
    seed
        A whole number of at least 0 and below 2^64.
    n_bus
        Buses, the substation among them, from 10 to 100,000.
    style
        "urban", "rural", "european-lv" or "us-mv", see ``styles.STYLES``.
    load_kw
        Sum of the active loads at peak, kW, before they are rounded; drawn with the style's density unless given.

    Raises
    ------
    ValueError
        For an invalid seed.
    FeederError
        For another style or number of buses, or a load that no feeder of the style carries at its drop.
    """
    seed = whole_seed(seed)
    if seed >= 2**64:
        raise ValueError(f"seed is {seed}; give less than 2^64")
    if style not in STYLES:
        raise FeederError(f"random feeder: {unknown('style', style, STYLES, '`dcgrid list feeders` lists all')}")
    if isinstance(n_bus, bool) or not isinstance(n_bus, int | np.integer) or not LEAST_BUSES <= n_bus <= MOST_BUSES:
        raise FeederError(f"random feeder: n_bus is {n_bus!r}; give a whole number from 10 to 100,000")
    if load_kw is not None and not 0.0 < load_kw < 1e9:
        raise FeederError(f"random feeder: load_kw is {load_kw!r}; give more than 0 and less than 1e9, or leave it out")
    drawn = draw_feeder(seed, int(n_bus), STYLES[style], load_kw)
    return _feeder(f"random-{style}-{n_bus}-{seed}", style, drawn)


def _feeder(name: str, style: str, drawn: DrawnFeeder) -> Feeder:
    ids = own_buses(len(drawn.p_kw))
    x_km, y_km = positions_km(drawn.tree, drawn.length_km)
    return Feeder.from_tables(
        name=name,
        base_kv=STYLES[style].base_kv,
        substation=ids[0],
        v0_pu=drawn.v0_pu,
        bus_ids=ids,
        p_load_kw=drawn.p_kw.tolist(),
        q_load_kvar=drawn.q_kvar.tolist(),
        from_bus=[ids[bus] for bus in drawn.tree.parent.tolist()],
        to_bus=ids[1:],
        r_ohm=np.round(drawn.r_ohm, 6).tolist(),
        x_ohm=np.round(drawn.x_ohm, 6).tolist(),
        rating_a=drawn.ampacity_a.tolist(),
        x=x_km.tolist(),
        y=y_km.tolist(),
    )
