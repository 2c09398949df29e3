"""Sags: the recorded sequence, and what is refused."""

import pytest

from dcgrid_env.core.checked import FieldError
from dcgrid_env.devices.ride_through.sags import SAG_SEQUENCES, Sag, virginia_2024


def test_the_sequence_of_2024_has_six_sags_within_82_s():
    first, *later = virginia_2024((3.0, 7.0))
    assert first.begin_s == (3.0, 7.0)
    assert first.since == "episode"
    assert len(later) == 5
    assert sum(sag.begin_s[0] for sag in later) == pytest.approx(82.0)
    assert {sag.begin_s for sag in later} == {(16.4, 16.4)}
    assert {sag.since for sag in later} == {"previous"}
    assert {(sag.duration_s, sag.retained_pu) for sag in (first, *later)} == {((0.042, 0.066), (0.25, 0.4))}
    assert SAG_SEQUENCES["virginia-2024"]()[0].begin_s == (10.0, 30.0)


@pytest.mark.parametrize(
    ("fields", "stored"),
    [
        ({"begin_s": 5}, (5.0, 5.0)),
        ({"begin_s": [0, 1e9]}, (0.0, 1e9)),
        ({"duration_s": 60.0}, (60.0, 60.0)),
        ({"retained_pu": (0.0, 1.0)}, (0.0, 1.0)),
    ],
)
def test_a_number_is_a_range_without_width_and_the_ends_are_allowed(fields, stored):
    sag = Sag(**{"begin_s": 1.0, "duration_s": 0.1, "retained_pu": 0.5} | fields)
    assert getattr(sag, next(iter(fields))) == stored


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"begin_s": -1.0}, "Sag: begin_s is -1.0; give a number from 0 to 1e"),
        ({"begin_s": (1.0, 2e9)}, "from 0 to 1e"),
        ({"duration_s": (0.0, 1.0)}, "Sag: duration_s is .*; give a shortest above 0 s"),
        ({"duration_s": 60.1}, "from 0 to 60, or a pair of them"),
        ({"retained_pu": 1.01}, "from 0 to 1, or a pair of them"),
        ({"retained_pu": (0.5, 0.4)}, "Sag: retained_pu is .*; give the lowest first"),
        ({"retained_pu": (0.1, 0.2, 0.3)}, "or a pair of them"),
        ({"since": "now"}, "Sag: since is 'now'; choose one of episode, previous"),
    ],
)
def test_a_sag_that_cannot_be_is_refused_by_field(fields, message):
    with pytest.raises(FieldError, match=message):
        Sag(**{"begin_s": 1.0, "duration_s": 0.1, "retained_pu": 0.5} | fields)
