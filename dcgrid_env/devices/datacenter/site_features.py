"""Features of data centres in addition to clock, queue and converter, such as a UPS.

Some features act on work before it is served (``admit``): they move it to other sites, or change the power that it
takes. Then the clock law determines the work served and the draw of a site. After that the features act one after the
other, from the chips towards the grid, each on the work served and the draw that the previous one returns. A feature
may delay work, which returns to the queue, or draw more or less power than the work takes.

A feature is a field of ``DataCenters`` that is None for sites without it, and a class in this package that implements
``SiteFeature``.
"""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple, Protocol

from dcgrid_env.core.arrays import Array, sum_last
from dcgrid_env.devices.datacenter.datacenter import DataCenterState
from dcgrid_env.devices.device import Channel, CostTerm, Field, Work
from dcgrid_env.devices.ratings import DataCenterParams
from dcgrid_env.devices.ride_through.connection import Supply

FeatureState = Any
"""State of a feature: a NamedTuple of arrays (row, slot, ..), each feature its own."""


class SiteState(NamedTuple):
    """State of data centres that have features: what ``DataCenterState`` has, and the state of each feature.

    A field of a feature's state is read by its name too: ``state.battery``.
    """

    backlog_kws: Array
    f_mhz: Array
    f_last_mhz: Array
    arrived_kw: Array
    served_kw: Array
    class_backlog_kws: Array
    class_arrived_kw: Array
    class_served_kw: Array
    features: tuple[Any, ...]

    def __getattr__(self, name: str) -> Any:
        for feature_state in self.features:
            if name in feature_state._fields:
                return getattr(feature_state, name)
        raise AttributeError(f"neither the sites nor a feature of theirs have a field {name!r}")

    @property
    def site(self) -> DataCenterState:
        """The state without features."""
        return DataCenterState(*self[: len(DataCenterState._fields)])


class Load(NamedTuple):
    """Work of an interval as features have made of it what sites are to do, (row, slot) each."""

    base_kw: Array
    """Draw other than for work, kW."""
    arrived_kw: Array
    """Dynamic power for the arriving work, kW."""
    compute_share: Array | None
    """See ``Work``."""
    energy_share: Array | None = None
    """Energy that work takes as a share of that at its trace's batch size; None for 1."""
    moved_kw: Array | None = None
    """Arriving work that comes from another site, kW; None for no such work."""


class FeatureInputs(NamedTuple):
    """Exogenous inputs of the features of a group of sites over an interval."""

    work: Work
    supply: Supply | None
    """The voltage, and sags; None where no feature makes a site leave the grid."""
    load: Load | None = None
    """Work as changed by features before it was served; None if unchanged."""


class PassiveFeature:
    """A feature that leaves alone what sites serve and draw; a base of those that do no more than their own methods."""

    def channels(self, params: DataCenterParams) -> tuple[Channel, ...]:
        """No channel."""
        return ()

    def step(
        self,
        params: DataCenterParams,
        feature_state: FeatureState,
        site: DataCenterState,
        p_kw: Array,
        setpoints: tuple[Array, ...],
        inputs: FeatureInputs,
        dt_s: float,
    ) -> tuple[Any, DataCenterState, Array]:
        """Change nothing, see ``SiteFeature.step``."""
        return feature_state, site, p_kw


class SiteFeature(Protocol):
    """A feature of a group of data centres, with its settings; its state is a NamedTuple of arrays (row, slot, ..).

    One that acts on the work before it is served is an ``AdmittingFeature``. One with a class attribute
    ``looks_ahead = True`` has the work of the coming interval as a third argument of ``observe``; one with
    ``accounts_last = True`` steps behind the others. One that draws power itself has ``with_supply``: from its state
    and the share of the site's draw that grid and battery supply, (row, slot), to its state.
    """

    amounts: ClassVar[tuple[str, ...]]
    """The amounts that its cost terms charge, see ``CostTerm.amount``."""

    def channels(self, params: DataCenterParams) -> tuple[Channel, ...]:
        """What controls it."""
        ...

    def fields(self, params: DataCenterParams, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """What agents observe of it, in the order of ``observe``."""
        ...

    def cost_terms(self, params: DataCenterParams, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        """What it is charged for."""
        ...

    def initial(self, params: DataCenterParams, zero: Array) -> FeatureState:
        """State before t = 0; ``zero`` is 0, (row, slot)."""
        ...

    def step(
        self,
        params: DataCenterParams,
        feature_state: FeatureState,
        site: DataCenterState,
        p_kw: Array,
        setpoints: tuple[Array, ...],
        inputs: FeatureInputs,
        dt_s: float,
    ) -> tuple[Any, DataCenterState, Array]:
        """Advance by one interval.

        Parameters
        ----------
        params
            Ratings of the sites.
        feature_state
            Its state of before.
        site, p_kw
            State of the sites at the end, and their draw over the interval, kW, (row, slot), as the features before it
            have left them.
        setpoints
            What each of its channels is set to, (row, slot) each.
        inputs
            What comes from outside.
        dt_s
            Length of the interval, s.

        Returns
        -------
        own, site, p_kw
            Its state at the end, and what it has made of the other two.
        """
        ...

    def observe(self, params: DataCenterParams, feature_state: FeatureState) -> tuple[Array, ...]:
        """Raw figures of the fields, (row, slot) each."""
        ...

    def amount(self, name: str, params: DataCenterParams, feature_state: FeatureState) -> Array:
        """What a cost term charges, one of ``amounts``, (row, slot)."""
        ...

    def totals(self, feature_state: FeatureState) -> dict[str, Array]:
        """Figures of all slots together in ``info``, (row,) each."""
        ...

    def metrics(
        self, params: DataCenterParams, history: SiteState, feature_state: FeatureState, dt_s: float
    ) -> dict[str, float]:
        """Figures of an episode from the sites' state over time and from its own, (T + 1, slot, ..) each."""
        ...


class AdmittingFeature(SiteFeature, Protocol):
    """A feature that acts on the work before it is served too."""

    def admit(
        self,
        params: DataCenterParams,
        state: SiteState,
        feature_state: FeatureState,
        load: Load,
        setpoints: tuple[Array, ...],
        work: Work,
        dt_s: float,
    ) -> tuple[Any, Load]:
        """Make of the work of an interval what the sites are to do.

        Parameters
        ----------
        params, state, own
            Ratings and state of the sites, and its own state, of before.
        load
            The work as the features before it have left it.
        setpoints
            What each of its channels is set to, (row, slot) each.
        work
            The work as it came.
        dt_s
            Length of the interval, s.

        Returns
        -------
        own, load
            Its state, and what it has made of the work.
        """
        ...


def with_share_served(site: DataCenterState, share: Array, dt_s: float) -> DataCenterState:
    """The state with this share of the work served, (row, slot); the rest is back in the queue."""
    by_class = share if site.class_served_kw.ndim == share.ndim else share[..., None]
    waiting = site.class_served_kw * (1.0 - by_class) * dt_s
    served, backlog = site.class_served_kw * by_class, site.class_backlog_kws + waiting
    one = by_class is share
    return site._replace(
        backlog_kws=backlog if one else sum_last(backlog),
        served_kw=served if one else sum_last(served),
        class_backlog_kws=backlog,
        class_served_kw=served,
    )
