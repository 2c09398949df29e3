"""The fields of data centres with the settings of a feature, and the objects built from them.

A class of settings may have a method ``check_slots`` or ``check_sites``, which raises FieldError for settings that are
invalid for the sites, and a method ``check_step`` for settings that are invalid for a step length.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from dcgrid_env.core.checked import FieldError, from_mapping, refuse
from dcgrid_env.devices.datacenter import batching, cooled_site, service_levels, smoothed_site, ups_site, work_routing
from dcgrid_env.devices.datacenter.batching import BatchedSites, Batching
from dcgrid_env.devices.datacenter.cooled_site import CooledSite, Cooling
from dcgrid_env.devices.datacenter.power_smoothing import PowerSmoothing
from dcgrid_env.devices.datacenter.service_levels import ServedSites, ServiceLevels
from dcgrid_env.devices.datacenter.site_features import SiteFeature
from dcgrid_env.devices.datacenter.site_storage import OF_SITES, SiteStorage
from dcgrid_env.devices.datacenter.smoothed_site import SmoothedSite
from dcgrid_env.devices.datacenter.ups_site import UpsSite
from dcgrid_env.devices.datacenter.work_routing import RoutedSites, Routing
from dcgrid_env.devices.ride_through.rules import UpsRideThrough, rule_of
from dcgrid_env.devices.storage.figures import metrics_of

SETTINGS: dict[str, type[Any]] = {
    "routing": Routing,
    "batching": Batching,
    "smoothing": PowerSmoothing,
    "cooling": Cooling,
    "ride_through": UpsRideThrough,
    "storage": SiteStorage,
    "service": ServiceLevels,
}
"""Class of the settings in each field, in the order in which features act.

The first act on the work, the next from the chips towards the grid. Service levels are last because they depend on the
work that was finally served.
"""
METRICS = (
    *work_routing.METRICS,
    *batching.METRICS,
    *smoothed_site.METRICS,
    *cooled_site.METRICS,
    *ups_site.METRICS,
    *metrics_of(OF_SITES, " behind sites"),
    *service_levels.METRICS,
)
"""Metrics of the features."""
_REQUIRED = {"ride_through": "curve=..", "storage": "p_rated_kw=.., energy_kwh=.."}
"""Required fields of each."""


def with_path(field: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function returns; a FieldError of settings names the field of the sites that holds them too."""
    try:
        return function(*arguments)
    except FieldError as error:
        raise error.within("DataCenters", field) from None


CONVERSIONS: dict[str, Callable[[Any], Any]] = {
    **{field: partial(with_path, field, from_mapping, kind) for field, kind in SETTINGS.items()},
    "ride_through": partial(with_path, "ride_through", rule_of, UpsRideThrough),
}
"""Function for each field that creates settings from their plain form, a mapping of their fields."""


def check_settings(sites: Any) -> None:
    """Raise FieldError for settings of another class, or that cannot be of these sites."""
    for name, kind in SETTINGS.items():
        settings = getattr(sites, name)
        if settings is None:
            continue
        if not isinstance(settings, kind):
            raise refuse(
                sites, name, f"give {kind.__name__}({_REQUIRED.get(name, '..')}), a mapping of its fields, or None"
            )
        if hasattr(settings, "check_sites"):
            with_path(name, settings.check_sites, sites.count, sites.idle_share)
        if hasattr(settings, "check_slots"):
            with_path(name, settings.check_slots, sites.count)
    if sites.storage is not None and sites.ride_through is not None:
        raise refuse(sites, "storage", "leave it out beside ride_through, or give Storages, agents of their own")


def check_step(sites: Any, dt_s: float) -> None:
    """Raise FieldError for settings that cannot be in steps of this length."""
    for name in SETTINGS:
        settings = getattr(sites, name)
        if hasattr(settings, "check_step"):
            settings.check_step(dt_s)


def features_of(sites: Any) -> tuple[SiteFeature, ...]:
    """The features that sites have, in the order in which they act."""
    moves_late = sites.routing is not None and sites.routing.move_latency_s > 0.0
    features = (
        sites.routing and RoutedSites(sites.routing, sites.boost_share),
        sites.batching and BatchedSites(sites.batching, sites.boost_share),
        sites.smoothing and SmoothedSite(sites.smoothing, sites.boost_share),
        sites.cooling and CooledSite(sites.cooling, sites.boost_share),
        sites.ride_through and UpsSite(sites.ride_through, sites.cooling),
        sites.storage,
        sites.service and ServedSites(sites.service, moves_late, sites.boost_share),
    )
    return tuple(feature for feature in features if feature is not None)
