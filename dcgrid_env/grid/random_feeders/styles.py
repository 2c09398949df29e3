"""Styles of random feeders: the distribution of each statistic. docs/random-feeders.md says where from."""

from __future__ import annotations

from dataclasses import dataclass

from dcgrid_env.grid.random_feeders.conductors import (
    ACSR,
    AL_ST_20_KV,
    NA2XS2Y_10_KV,
    NA2XS2Y_20_KV,
    NAYY,
    Conductor,
)

Range = tuple[float, float]
"""Limits between which a figure is drawn evenly, once for a feeder."""


@dataclass(frozen=True)
class Style:
    """Properties of the random feeders of a style."""

    about: str
    base_kv: float
    v0_pu: Range
    """Voltage at the substation at peak, p.u."""
    buses_a_departure: float
    """Buses for each branch that leaves the substation; infinite where there is one such branch."""
    leaf_share: Range
    """Share of buses at which the feeder ends."""
    trunk: Range
    """Hops of the longest departure by the square root of the number of buses."""
    loaded_share: Range
    """Share of buses with a load."""
    mean_kw: Range
    """Mean peak load of buses with one, kW."""
    load_sigma: Range
    """Standard deviation of the logarithm of the loads."""
    power_factor: Range
    length_m: Range
    """Median length of a branch, m."""
    length_sigma: float
    """Standard deviation of the logarithm of the lengths."""
    drop_pu: Range
    """Difference of voltage between the substation and the lowest bus at peak, p.u."""
    utilisation: Range
    """Largest share of its ampacity by which a conductor is chosen."""
    whole_at: int
    """Buses from which on more of them draw the same territory in finer detail: no more load, and shorter branches."""
    conductors: tuple[tuple[float, tuple[Conductor, ...]], ...]
    """Families of conductors by size, each with the share of departures and laterals that are built of it."""

    def n_loaded(self, n_bus: int) -> int:
        """Buses with a load that every feeder of so many buses has at least."""
        return max(1, int(self.loaded_share[0] * (n_bus - 1)))


STYLES = {
    "urban": Style(
        about="cables of 10 kV in a city, many short departures",
        base_kv=10.0,
        v0_pu=(1.0, 1.03),
        buses_a_departure=12.3,
        leaf_share=(0.10, 0.17),
        trunk=(1.3, 1.8),
        loaded_share=(0.95, 1.0),
        mean_kw=(300.0, 440.0),
        load_sigma=(0.2, 0.4),
        power_factor=(0.91, 0.95),
        length_m=(190.0, 290.0),
        length_sigma=0.5,
        drop_pu=(0.008, 0.028),
        utilisation=(0.30, 0.55),
        whole_at=135,
        conductors=(
            (0.1, NA2XS2Y_10_KV),
            (0.2, NA2XS2Y_10_KV[1:]),
            (0.4, NA2XS2Y_10_KV[2:]),
            (0.3, NA2XS2Y_10_KV[3:]),
        ),
    ),
    "rural": Style(
        about="cables and overhead lines of 20 kV in the country, long departures",
        base_kv=20.0,
        v0_pu=(1.0, 1.03),
        buses_a_departure=11.6,
        leaf_share=(0.11, 0.20),
        trunk=(1.8, 2.6),
        loaded_share=(0.88, 1.0),
        mean_kw=(150.0, 450.0),
        load_sigma=(0.4, 0.7),
        power_factor=(0.93, 0.98),
        length_m=(400.0, 800.0),
        length_sigma=0.9,
        drop_pu=(0.012, 0.07),
        utilisation=(0.30, 0.60),
        whole_at=94,
        conductors=((0.4, NA2XS2Y_20_KV), (0.4, NA2XS2Y_20_KV[1:]), (0.2, AL_ST_20_KV)),
    ),
    "european-lv": Style(
        about="cables of 0.4 kV behind a transformer of a quarter",
        base_kv=0.4,
        v0_pu=(0.98, 1.03),
        buses_a_departure=17.0,
        leaf_share=(0.08, 0.40),
        trunk=(1.5, 2.8),
        loaded_share=(0.5, 0.95),
        mean_kw=(2.0, 8.0),
        load_sigma=(0.3, 0.8),
        power_factor=(0.92, 0.97),
        length_m=(11.0, 30.0),
        length_sigma=0.9,
        drop_pu=(0.012, 0.06),
        utilisation=(0.30, 0.60),
        whole_at=110,
        conductors=((0.3, NAYY), (0.5, NAYY[1:]), (0.2, NAYY[2:])),
    ),
    "us-mv": Style(
        about="one overhead feeder of 12.47 kV in North America, with laterals",
        base_kv=12.47,
        v0_pu=(1.0, 1.05),
        buses_a_departure=float("inf"),
        leaf_share=(0.12, 0.33),
        trunk=(1.6, 2.4),
        loaded_share=(0.6, 0.95),
        mean_kw=(40.0, 140.0),
        load_sigma=(0.5, 1.0),
        power_factor=(0.85, 0.92),
        length_m=(100.0, 400.0),
        length_sigma=0.8,
        drop_pu=(0.04, 0.10),
        utilisation=(0.35, 0.65),
        whole_at=141,
        conductors=((0.4, ACSR), (0.4, ACSR[1:]), (0.2, ACSR[2:])),
    ),
}
"""The styles by name."""


def own_buses(n_bus: int) -> tuple[str, ...]:
    """Names of the buses of a random feeder, "0", the substation, "1" and so on."""
    return tuple(map(str, range(n_bus)))
