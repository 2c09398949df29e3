"""The features that sites may have, by the field of ``DataCenters`` that holds their settings, checked and made."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import partial
from typing import Any

from dcgrid_env.core.checked import FieldError, refuse
from dcgrid_env.devices.datacenter.cooled_site import CooledSite, Cooling
from dcgrid_env.devices.datacenter.power_smoothing import PowerSmoothing
from dcgrid_env.devices.datacenter.site_features import SiteFeature
from dcgrid_env.devices.datacenter.smoothed_site import SmoothedSite
from dcgrid_env.devices.datacenter.ups_site import UpsSite
from dcgrid_env.devices.ride_through.rules import UpsRideThrough, rule_of

SETTINGS: dict[str, type[Any]] = {"smoothing": PowerSmoothing, "cooling": Cooling}
"""Kind of the settings of each field that has a mapping of them as its plain form."""


def with_path(field: str, function: Any, *given: Any, **fields: Any) -> Any:
    """What a function returns; a FieldError of settings is one of the field of the sites that holds them."""
    try:
        return function(*given, **fields)
    except FieldError as error:
        raise FieldError("DataCenters", f"{field}.{error.name}", error.value, error.remedy) from None


def _settings_of(field: str, value: Any) -> Any:
    """Settings out of a mapping of their fields; any other value as it is. FieldError for a field that there is not."""
    if not isinstance(value, Mapping):
        return value
    there = [known.name for known in dataclasses.fields(SETTINGS[field])]
    for name in value:
        if name not in there:
            raise FieldError("DataCenters", f"{field}.{name}", ..., f"is no field; there are {', '.join(there)}")
    return with_path(field, SETTINGS[field], **value)


CONVERSIONS = {name: partial(_settings_of, name) for name in SETTINGS} | {
    "ride_through": partial(rule_of, UpsRideThrough)
}
"""What makes settings out of their plain form, by field; see ``checked.settle``."""


def check_features(sites: Any) -> None:
    """Raise FieldError for a field of sites that holds no settings, or some that do not fit the sites."""
    if sites.ride_through is not None:
        if not isinstance(sites.ride_through, UpsRideThrough):
            raise refuse(sites, "ride_through", "give UpsRideThrough(curve=..), a mapping of its fields, or None")
        sites.ride_through.check_slots(sites.count)
    for name, kind in SETTINGS.items():
        value = getattr(sites, name)
        if value is not None and not isinstance(value, kind):
            raise refuse(sites, name, f"give {kind.__name__}(..), a mapping of its fields, or None")
    if sites.smoothing is not None:
        with_path("smoothing", sites.smoothing.check_sites, sites.count, sites.idle_share)


def features_of(sites: Any) -> tuple[SiteFeature, ...]:
    """The features that sites have, from the chips towards the grid."""
    smoothed = (SmoothedSite(sites.smoothing, sites.boost_share),) if sites.smoothing else ()
    cooled = (CooledSite(sites.cooling, sites.boost_share),) if sites.cooling else ()
    return (*smoothed, *cooled, *((UpsSite(sites.ride_through),) if sites.ride_through else ()))


def plain_settings(settings: Any) -> dict[str, Any]:
    """The plain form of settings: a mapping of their fields, those at their default left out."""
    fields = {field.name: field.default for field in dataclasses.fields(settings)}
    values = {name: getattr(settings, name) for name in fields}
    return {n: list(v) if isinstance(v, tuple) else v for n, v in values.items() if v != fields[n]}
