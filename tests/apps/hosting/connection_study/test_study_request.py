"""The study's file as fields: what is allowed, and what an error names."""

import pytest

from dcgrid_env.apps.hosting.connection_study.study_request import SECTIONS, StudyRequest
from dcgrid_env.core.checked import FieldError, from_mapping

GIVEN = {"feeder": "ieee33", "bus": 12, "mw": 0.5}


def test_defaults_and_plain_forms():
    request = from_mapping(StudyRequest, GIVEN | {"limits": {"pst": 0.8}, "leave_out": ["day"]})
    assert (request.bus, request.limits.pst, request.leave_out) == ("12", 0.8, ("day",))
    assert (request.outages, request.several_sites) == ((), None)
    assert (request.controllers, request.ride_through.curve) == (("none", "droop"), "itic")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"bus": ""}, "bus is ''; give a text"),
        ({"mw": -1.0}, r"mw is -1.0; give a finite number"),
        ({"feeder": None}, "feeder is None; give a feeder, a scenario, or both"),
        ({"controllers": []}, "name at least one controller"),
        ({"controllers": "none"}, "give a list of names"),
        ({"leave_out": ["costs"]}, f"its sections are {', '.join(SECTIONS)}"),
        ({"limits": {"pst": 0.0}}, "limits.pst is 0.0"),
        ({"limits": {"ramp_kw_per_s": 0}}, "limits.ramp_kw_per_s is 0; give a ramp > 0 kW/s"),
        ({"limits": 3}, r"limits is 3; give FluctuationLimits\(\.\.\.\) or a mapping of its fields"),
        ({"ride_through": {"curve": "none"}}, "ride_through.curve is 'none'; choose one of itic"),
        ({"outages": "all"}, "give a list of names"),
        ({"several_sites": {"buses": []}}, r"several_sites.buses is \(\); give a list of at least one bus"),
        ({"several_sites": {"buses": ["6"], "rule": "fair"}}, "several_sites.rule is 'fair'; choose one of equal, sum"),
        ({"capacity": []}, r"capacity is \(\); give a table"),
    ],
)
def test_what_a_request_cannot_be(changed, message):
    with pytest.raises(FieldError, match=message):
        from_mapping(StudyRequest, GIVEN | changed)


def test_an_unknown_field_is_named():
    with pytest.raises(FieldError, match="size"):
        from_mapping(StudyRequest, GIVEN | {"size": 3})
