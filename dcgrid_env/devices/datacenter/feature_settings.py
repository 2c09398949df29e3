"""The fields of data centres that hold the settings of a feature, and what is made of them.

A class of settings may have a method ``check_slots``, which raises FieldError for what cannot be of as many sites, and
one ``check_step`` for what cannot be in steps of a length.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from dcgrid_env.core.checked import FieldError, from_mapping, refuse
from dcgrid_env.devices.datacenter.batching import BatchedSites, Batching
from dcgrid_env.devices.datacenter.service_levels import ServedSites, ServiceLevels
from dcgrid_env.devices.datacenter.site_features import SiteFeature
from dcgrid_env.devices.datacenter.site_storage import SiteStorage
from dcgrid_env.devices.datacenter.ups_site import UpsSite
from dcgrid_env.devices.datacenter.work_routing import RoutedSites, Routing
from dcgrid_env.devices.ride_through.rules import UpsRideThrough, rule_of


def _of_work(field: str, kind: type[Any], value: Any) -> Any:
    """Settings out of their plain form, errors with the field of the data centres in front."""
    try:
        return from_mapping(kind, value)
    except FieldError as error:
        raise FieldError("DataCenters", f"{field}.{error.name}", error.value, error.remedy) from None


_OF_WORK: dict[str, type[Any]] = {"routing": Routing, "batching": Batching, "service": ServiceLevels}
SETTINGS: dict[str, type[Any]] = {"ride_through": UpsRideThrough, "storage": SiteStorage, **_OF_WORK}
"""The class of the settings in each field."""
_REQUIRED = {"ride_through": "curve=..", "storage": "p_rated_kw=.., energy_kwh=..", **dict.fromkeys(_OF_WORK, "")}
"""What has to be given of each."""

CONVERSIONS: dict[str, Callable[[Any], Any]] = {
    "ride_through": partial(rule_of, UpsRideThrough),
    "storage": partial(from_mapping, SiteStorage),
    **{field: partial(_of_work, field, kind) for field, kind in _OF_WORK.items()},
}
"""How settings are made of their plain form, a mapping of their fields, for each field."""


def check_settings(sites: Any) -> None:
    """Raise FieldError for settings of another class, or that cannot be of these sites."""
    for name, kind in SETTINGS.items():
        given = getattr(sites, name)
        if given is None:
            continue
        if not isinstance(given, kind):
            raise refuse(sites, name, f"give {kind.__name__}({_REQUIRED[name]}), a mapping of its fields, or None")
        if hasattr(given, "check_slots"):
            given.check_slots(sites.count)
    if sites.storage is not None and sites.ride_through is not None:
        raise refuse(sites, "storage", "leave it out beside ride_through, or give Storages, agents of their own")


def check_step(sites: Any, dt_s: float) -> None:
    """Raise FieldError for settings that cannot be in steps of this length."""
    for name in SETTINGS:
        given = getattr(sites, name)
        if hasattr(given, "check_step"):
            given.check_step(dt_s)


def features_of(sites: Any) -> tuple[SiteFeature, ...]:
    """The features that sites have, in the order in which they act: on the work, then from the chips towards the grid,
    and service levels last, since they see what was served in the end."""
    moves_late = sites.routing is not None and sites.routing.move_latency_s > 0.0
    features = (
        sites.routing and RoutedSites(sites.routing, sites.boost_share),
        sites.batching and BatchedSites(sites.batching),
        sites.ride_through and UpsSite(sites.ride_through),
        sites.storage,
        sites.service and ServedSites(sites.service, moves_late),
    )
    return tuple(feature for feature in features if feature is not None)
