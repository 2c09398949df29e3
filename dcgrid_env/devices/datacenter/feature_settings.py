"""The fields of data centres with the settings of a feature, and the objects built from them.

A class of settings may have a method ``check_slots`` or ``check_sites``, which raises FieldError for settings that are
invalid for the sites, and a method ``check_step`` for settings that are invalid for a step length.
"""

from __future__ import annotations

from typing import Any

from dcgrid_env.core.checked import inside, refuse
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
from dcgrid_env.devices.ride_through.rules import UpsRideThrough
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


def check_settings(sites: Any) -> None:
    """Raise FieldError for settings that cannot be of these sites."""
    for name in SETTINGS:
        settings = getattr(sites, name)
        with inside("DataCenters", name):
            if hasattr(settings, "check_sites"):
                settings.check_sites(sites.count, sites.idle_share)
            if hasattr(settings, "check_slots"):
                settings.check_slots(sites.count)
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
