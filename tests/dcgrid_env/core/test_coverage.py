"""Coverage of fast paths: everything that is not listed is refused, unless it has its default."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, partial, wraps
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
import pytest

from dcgrid_env.core.coverage import Coverage


@dataclass(frozen=True)
class Law:
    power: float = 1.0

    def speed(self):
        return self.power


@dataclass(frozen=True)
class Site:
    rated_kw: Any = 1.0
    law: Any = field(default_factory=Law)
    profile: Any = None

    @property
    def idle_kw(self):
        return 0.3 * self.rated_kw

    @cached_property
    def double_kw(self):
        return 2.0 * self.rated_kw

    @staticmethod
    def unit():
        return "kW"


class Figures(NamedTuple):
    v_pu: float
    p_kw: float = 0.0


class OwnSite(Site):
    pass


COVERED = Coverage({Site: "rated_kw law", Law: ""}, {Figures: "v_pu p_kw"})


@pytest.mark.parametrize(
    ("value", "unknown"),
    [
        (Site(), None),
        (Site(rated_kw=(2.0, 3)), None),
        (Site(rated_kw=np.array([2.0])), None),
        (Site(rated_kw=np.float32(2.0)), None),
        ((Site(), Site(3.0)), None),
        (Site(profile=1.0), "Site.profile"),
        (Site(profile=np.zeros(2)), "Site.profile"),
        (Site(law=Law(2.0)), "Law.power"),
        ((Site(), Site(law=(Law(), Law(2.0)))), "Law.power"),
        (OwnSite(), "OwnSite"),
        (Site(law="linear"), None),
        (Site(law=object()), "object"),
        (Site(law=Figures(1.0)), "Figures"),
        (Site(law=[Law()]), "list"),
    ],
)
def test_what_is_not_listed_must_have_its_default(value, unknown):
    assert COVERED.first_unknown(value) == unknown
    assert COVERED.includes(value) == (unknown is None)


def test_a_star_covers_what_a_field_contains():
    assert Coverage({Site: "rated_kw law* profile"}).includes(Site(law=object(), profile=2.0))


def test_a_field_without_default_must_be_listed():
    @dataclass
    class Sized:
        size: float

    assert not Coverage({Sized: ""}).includes(Sized(1.0))
    assert Coverage({Sized: "size"}).includes(Sized(1.0))


def test_all_fields_of_named_tuples_must_be_listed():
    assert Coverage({Site: ""}, {Figures: "v_pu"}).first_unknown(Site()) == "Figures.p_kw"


def speed(self):
    return 2.0 * self.power


@wraps(Law.speed)
def wrapped(self):
    return 2.0 * self.power


@pytest.mark.parametrize("function", [speed, wrapped, partial(speed), mock.Mock()])
def test_a_replaced_function_is_refused(function, monkeypatch):
    assert COVERED.includes(Site())
    monkeypatch.setattr(Law, "speed", function)
    assert COVERED.first_unknown(Site()) == "Law"


@pytest.mark.parametrize(
    ("name", "member"), [("idle_kw", property(speed)), ("unit", staticmethod(speed)), ("extra", speed)]
)
def test_a_replaced_property_and_an_added_function_are_refused(name, member, monkeypatch):
    monkeypatch.setattr(Site, name, member, raising=False)
    assert COVERED.first_unknown(Site()) == "Site"


def test_a_function_of_an_instance_is_refused():
    law, site = Law(), Site()
    assert site.double_kw == 2.0
    assert COVERED.includes(site)
    object.__setattr__(law, "speed", lambda: 2.0)
    assert COVERED.first_unknown(law) == "Law"
