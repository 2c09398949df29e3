"""A radial feeder drawn at random with the statistics of published ones."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.seeds import whole_seed
from dcgrid_env.grid.feeder import Feeder
from dcgrid_env.grid.random_feeders.drawn import DrawnFeeder, draw_feeder
from dcgrid_env.grid.random_feeders.layout import positions_km
from dcgrid_env.grid.random_feeders.styles import STYLES, own_buses
from dcgrid_env.grid.topology import FeederError

MOST_BUSES = 100_000
LEAST_BUSES = 10


def random_feeder(seed: int, *, n_bus: int = 60, style: str = "urban", load_kw: float | None = None) -> Feeder:
    """Draw a radial feeder; the same arguments give the same one on every machine.

    It has a power flow at twice its loads, a drop to its lowest bus that its style has, conductors that carry their
    current at peak and grow towards the substation, and coordinates. docs/random-feeders.md compares it with published
    feeders.

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
        For a seed that cannot be.
    FeederError
        For another style or number of buses, or a load that no feeder of the style carries at its drop.
    """
    seed = whole_seed(seed)
    if seed >= 2**64:
        raise ValueError(f"seed is {seed}; give less than 2^64")
    if style not in STYLES:
        raise FeederError(f"random feeder: style is {style!r}; choose one of {', '.join(STYLES)}")
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
