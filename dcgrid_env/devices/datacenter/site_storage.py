"""Storage behind a data centre's converter, controlled by the data centre's agent: a feature of the site.

It charges with the remaining part of the site's rating and may discharge beyond the site's draw, back to the rating:

    -p_rated - p <= storage <= max(p_rated - p, 0)          p: draw of the site without the storage

so the site's draw from the grid never exceeds what it does without a storage, or the rating, and the converter's
reactive side follows the sum. A storage with a separate converter is an agent, ``Storages``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from dcgrid_env.core.arrays import Array, as_like, namespace, positive_part
from dcgrid_env.core.cache import PickledByFields, cached_on_owner
from dcgrid_env.core.checked import settle
from dcgrid_env.devices.datacenter.datacenter import DataCenterState
from dcgrid_env.devices.datacenter.site_features import FeatureInputs, SiteState
from dcgrid_env.devices.device import Channel, CostTerm, Field
from dcgrid_env.devices.ratings import DataCenterParams
from dcgrid_env.devices.storage import energy_balance, figures
from dcgrid_env.devices.storage.energy_balance import StorageParams, StorageState

CHANNEL = "storage_p"
"""Name of the channel that is the storage's draw, kW, negative to discharge."""
OF_SITES = "site_"
"""Prefix of its cost terms, figures and metrics, which separates them from those of storages that are agents."""


class SiteStorageState(NamedTuple):
    """State of the storage of each site."""

    storage: StorageState


@dataclass(frozen=True, kw_only=True)
class SiteStorage(figures.StorageFigures, PickledByFields):
    """Storages of data centres that differ only in their figures. A figure is one number for all, or one for each."""

    amounts: ClassVar[tuple[str, ...]] = (f"{OF_SITES}ageing", f"{OF_SITES}missing")

    def __post_init__(self) -> None:
        settle(self)

    def check_slots(self, slots: int) -> None:
        """Raise FieldError for an invalid figure of that many storages."""
        self.check_figures(slots)

    @cached_on_owner
    def params(self, sites: int) -> StorageParams:
        """Figures as arrays over the sites."""
        return self.figures_of(sites)

    def channels(self, params: DataCenterParams) -> tuple[Channel, ...]:
        """Channel of the storage's draw."""
        p_kw = self.params(len(params.p_rated_kw)).p_rated_kw
        return (Channel(CHANNEL, "kW", -p_kw, p_kw, rest=0.0 * p_kw),)

    def fields(self, params: DataCenterParams, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """State of charge, and how much it can charge and discharge over the coming interval by its energy."""
        return figures.fields(self.params(len(params.p_rated_kw)))

    def cost_terms(self, params: DataCenterParams, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        """Cost terms: throughput, and energy that is missing at the end."""
        return figures.cost_terms(self.params(len(params.p_rated_kw)), OF_SITES)

    def initial(self, params: DataCenterParams, zero: Array) -> SiteStorageState:
        """Return the initial state with the initial energy."""
        return SiteStorageState(energy_balance.initial(self._like(zero), zero))

    def step(
        self,
        params: DataCenterParams,
        feature_state: SiteStorageState,
        site: DataCenterState,
        p_kw: Array,
        setpoints: tuple[Array, ...],
        inputs: FeatureInputs,
        dt_s: float,
    ) -> tuple[SiteStorageState, DataCenterState, Array]:
        """Charge or discharge as far as there is room, energy and rating, see ``SiteFeature.step``."""
        xp = namespace(p_kw)
        highest, lowest = positive_part(params.p_rated_kw - p_kw), -params.p_rated_kw - p_kw
        asked_kw = xp.maximum(xp.minimum(setpoints[0], highest), lowest)
        after = energy_balance.step(self._like(p_kw), feature_state.storage, asked_kw, inputs.work.available, dt_s)
        return SiteStorageState(after), site, p_kw + after.storage_kw

    def observe(self, params: DataCenterParams, feature_state: SiteStorageState) -> tuple[Array, ...]:
        """Raw figures of the fields, kWh and kW."""
        return (
            feature_state.storage.stored_kwh,
            feature_state.storage.charge_limit_kw,
            feature_state.storage.discharge_limit_kw,
        )

    def amount(self, name: str, params: DataCenterParams, feature_state: SiteStorageState) -> Array:
        """Throughput, kW, or energy that is missing, kWh, each times its price."""
        return figures.amount(name, self._like(feature_state.storage.stored_kwh), feature_state.storage)

    def totals(self, feature_state: SiteStorageState) -> dict[str, Array]:
        """Return the stored energy, throughput, losses and missing energy of all sites' storages, kWh."""
        return figures.totals(feature_state.storage, OF_SITES)

    def metrics(
        self, params: DataCenterParams, history: SiteState, feature_state: SiteStorageState, dt_s: float
    ) -> dict[str, float]:
        """Return the energy at the end, its minimum, the throughput, the losses and the missing energy."""
        return figures.metrics(self.params(len(params.p_rated_kw)), feature_state.storage, OF_SITES)

    def _like(self, values: Array) -> StorageParams:
        """Figures as arrays of the kind of ``values``, (row, slot)."""
        return StorageParams(*(as_like(figure, values) for figure in self.params(values.shape[-1])))
