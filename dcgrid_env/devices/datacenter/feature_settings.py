"""The fields of data centres that hold the settings of a feature, and what is made of them.

A class of settings has a method ``check_slots`` or ``check_sites``, which raises FieldError for what cannot be of such
sites, unless it fits all.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from dcgrid_env.core.checked import FieldError, from_mapping, refuse
from dcgrid_env.devices.datacenter.cooled_site import CooledSite, Cooling
from dcgrid_env.devices.datacenter.power_smoothing import PowerSmoothing
from dcgrid_env.devices.datacenter.site_features import SiteFeature
from dcgrid_env.devices.datacenter.site_storage import SiteStorage
from dcgrid_env.devices.datacenter.smoothed_site import SmoothedSite
from dcgrid_env.devices.datacenter.ups_site import UpsSite
from dcgrid_env.devices.ride_through.rules import UpsRideThrough, rule_of

SETTINGS: dict[str, type[Any]] = {
    "smoothing": PowerSmoothing,
    "cooling": Cooling,
    "ride_through": UpsRideThrough,
    "storage": SiteStorage,
}
"""The class of the settings in each field, in the order in which features act, from the chips towards the grid."""
_REQUIRED = {"smoothing": "..", "cooling": "..", "ride_through": "curve=..", "storage": "p_rated_kw=.., energy_kwh=.."}
"""What has to be given of each."""


def with_path(field: str, function: Callable[..., Any], *given: Any) -> Any:
    """What a function returns; a FieldError of settings names the field of the sites that holds them too."""
    try:
        return function(*given)
    except FieldError as error:
        raise FieldError("DataCenters", f"{field}.{error.name}", error.value, error.remedy) from None


CONVERSIONS: dict[str, Callable[[Any], Any]] = {
    "smoothing": partial(with_path, "smoothing", from_mapping, PowerSmoothing),
    "cooling": partial(with_path, "cooling", from_mapping, Cooling),
    "ride_through": partial(rule_of, UpsRideThrough),
    "storage": partial(from_mapping, SiteStorage),
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
        if name == "smoothing":
            with_path(name, given.check_sites, sites.count, sites.idle_share)
        elif name != "cooling":
            given.check_slots(sites.count)
    if sites.storage is not None and sites.ride_through is not None:
        raise refuse(sites, "storage", "leave it out beside ride_through, or give Storages, agents of their own")


def features_of(sites: Any) -> tuple[SiteFeature, ...]:
    """The features that sites have, in the order in which they act."""
    smoothed = () if sites.smoothing is None else (SmoothedSite(sites.smoothing, sites.boost_share),)
    cooled = () if sites.cooling is None else (CooledSite(sites.cooling, sites.boost_share),)
    ups = () if sites.ride_through is None else (UpsSite(sites.ride_through),)
    storage = () if sites.storage is None else (sites.storage,)
    return (*smoothed, *cooled, *ups, *storage)
