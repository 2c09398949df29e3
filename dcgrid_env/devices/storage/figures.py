"""Figures of a storage in any device, its observed fields, cost terms and metrics."""

from __future__ import annotations

from dataclasses import dataclass

from dcgrid_env.core.arrays import Array, namespace, sum_last
from dcgrid_env.core.metric import Metric, cost_metric
from dcgrid_env.devices.device import CostTerm, Field
from dcgrid_env.devices.ratings import Rating, check_each, check_rating, per_device, read_only
from dcgrid_env.devices.storage.energy_balance import StorageParams, StorageState

_RANGES = {
    "charge_efficiency": (0.01, 1.0),
    "discharge_efficiency": (0.01, 1.0),
    "standby_share_per_h": (0.0, 0.99),
    "initial_share": (0.0, 1.0),
    "returned_share": (0.01, 1.0),
    "ageing_price": (0.0, 1e6),
    "missing_price": (1e-3, 1e6),
}


@dataclass(frozen=True, kw_only=True)
class StorageFigures:
    """Figures of storages. A figure is one number for all of them, or one for each."""

    p_rated_kw: Rating
    """Largest charge and discharge at the grid, kW."""
    energy_kwh: Rating
    """Usable energy, kWh."""
    charge_efficiency: Rating = 0.95
    """Share of the energy drawn from the grid that is stored."""
    discharge_efficiency: Rating = 0.95
    """Share of the energy taken out that reaches the grid."""
    standby_share_per_h: Rating = 0.0
    """Share of the stored energy that is lost in an hour, even when inactive."""
    initial_share: Rating = 0.5
    """Stored energy before t = 0, as a share of ``energy_kwh``."""
    returned_share: Rating = 1.0
    """Share of the initial energy that must be stored at the end of an episode."""
    ageing_price: Rating = 0.02
    """Cost of throughput: the increase of c_t when all storages run at their ratings."""
    missing_price: Rating = 9.0
    """Cost of missing energy at the end, for each second at the rating that all storages lack; the default is that of
    leftover work."""

    def check_figures(self, count: int) -> None:
        """Raise FieldError for an invalid figure of that many storages."""
        check_rating(self, "p_rated_kw", count)
        check_rating(self, "energy_kwh", count)
        for name, (low, high) in _RANGES.items():
            check_each(self, name, count, low, high)

    def figures_of(self, count: int) -> StorageParams:
        """Return the figures as arrays over that many storages."""
        figure = {name: per_device(getattr(self, name), count) for name in ("p_rated_kw", "energy_kwh", *_RANGES)}
        initial = figure.pop("initial_share") * figure["energy_kwh"]
        returned = figure.pop("returned_share") * initial
        params = StorageParams(initial_kwh=initial, returned_kwh=returned, **figure)
        return StorageParams(*map(read_only, params))


def fields(params: StorageParams) -> tuple[Field, ...]:
    """Return the observed fields: state of charge, and possible charge and discharge over the coming interval."""
    return (
        Field("stored", "share of the energy", 0.0, 1.0, params.energy_kwh),
        Field("charge_limit", "share of the rating", 0.0, 1.0, params.p_rated_kw),
        Field("discharge_limit", "share of the rating", 0.0, 1.0, params.p_rated_kw),
    )


def cost_terms(params: StorageParams, prefix: str = "") -> tuple[CostTerm, ...]:
    """Return the cost terms, throughput and missing energy at the end, with ``prefix`` in their names."""
    rated, of_all = params.p_rated_kw, float(params.p_rated_kw.sum()) or 1.0
    ageing = float(params.ageing_price.max(initial=0.0))
    missing = float((params.missing_price * params.returned_kwh * 3600.0 / rated).max(initial=0.0))
    return (
        CostTerm(f"{prefix}ageing", f"{prefix}ageing", rated, of_all, ageing, weight=1.0),
        CostTerm(
            f"{prefix}missing", f"{prefix}missing", rated / 3600.0, of_all / 3600.0, missing, at_end=True, weight=1.0
        ),
    )


def amount(name: str, params: StorageParams, state: StorageState) -> Array:
    """Return the throughput, kW, or the missing energy, kWh, each times its price, (row, slot)."""
    if name.endswith("missing"):
        return state.missing_kwh * params.missing_price
    return namespace(state.storage_kw).abs(state.storage_kw) * params.ageing_price


def totals(state: StorageState, prefix: str = "") -> dict[str, Array]:
    """Return the stored energy, throughput, losses and missing energy of all storages, kWh, (row,) each.

    Their names begin with ``prefix``.
    """
    return {
        f"{prefix}stored_kwh": sum_last(state.stored_kwh),
        f"{prefix}storage_throughput_kwh": sum_last(state.throughput_kwh),
        f"{prefix}storage_loss_kwh": sum_last(state.storage_loss_kwh),
        f"{prefix}storage_missing_kwh": sum_last(state.missing_kwh),
    }


def metrics_of(prefix: str = "", behind: str = "") -> tuple[Metric, ...]:
    """Return the metrics of storages, whose names begin with ``prefix`` and whose labels end with ``behind``."""
    return (
        cost_metric(f"{prefix}ageing", f"ageing cost of storage{behind}"),
        cost_metric(f"{prefix}missing", f"cost of missing energy{behind}"),
        Metric(f"{prefix}stored_end_pct", f"stored at the end{behind}", "%", 1, "neither",
            "stored energy at the end, as a share of the capacity of all storages", "last"),
        Metric(f"{prefix}stored_lowest_pct", f"least stored{behind}", "%", 1, "neither",
            "least stored energy, as the same share", "min", over_episodes="min"),
        Metric(f"{prefix}storage_throughput_kwh", f"throughput of storage{behind}", "kWh", 2, "lower",
            "energy charged and energy discharged, at the grid, over the steps 1 .. T", "sum", tables=("run",)),
        Metric(f"{prefix}storage_loss_kwh", f"energy lost in storage{behind}", "kWh", 2, "lower",
            "energy drawn that is neither given back nor stored at the end", "sum"),
        Metric(f"{prefix}storage_missing_kwh", f"energy missing in storage{behind}", "kWh", 2, "lower",
            "energy that is missing at the end of what is to be returned", "last", tables=("run",)),
    )  # fmt: skip


def metrics(params: StorageParams, history: StorageState, prefix: str = "") -> dict[str, float]:
    """Return the energy at the end, its minimum, the throughput, the losses and the missing energy.

    Their names begin with ``prefix``.
    """
    energy = float(params.energy_kwh.sum()) or 1.0
    throughput, loss = (sum_last(total[-1] - total[0]) for total in (history.throughput_kwh, history.storage_loss_kwh))
    return {
        f"{prefix}stored_end_pct": 100.0 * sum_last(history.stored_kwh[-1]) / energy,
        f"{prefix}stored_lowest_pct": 100.0 * sum_last(history.stored_kwh).min() / energy,
        f"{prefix}storage_throughput_kwh": throughput,
        f"{prefix}storage_loss_kwh": loss,
        f"{prefix}storage_missing_kwh": sum_last(history.missing_kwh[-1]),
    }
