"""The type of requests: copies, order, and what it refuses."""

import numpy as np
import pytest

from dcgrid_env.traces import Requests, TraceError


def test_holds_read_only_copies():
    arrival_s = np.array([0.0, 1.0, 1.0])
    made = Requests(arrival_s, np.array([5, 6, 7]), np.array([1.0, 2.0, 3.0]), 10.0)
    arrival_s[0] = 9.0
    assert made.arrival_s.tolist() == [0.0, 1.0, 1.0]
    assert made.generated_tokens.tolist() == [1, 2, 3]
    assert made.generated_tokens.dtype == np.int64
    assert len(made) == 3
    assert str(made.provenance) == "unknown origin"
    for values in (made.arrival_s, made.context_tokens, made.generated_tokens):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 3


def test_may_be_empty():
    assert len(Requests(np.zeros(0), np.zeros(0, int), np.zeros(0, int), 10.0)) == 0


@pytest.mark.parametrize(
    ("columns", "duration_s", "message"),
    [
        (([0, 1], [1], [1, 1]), 2.0, r"'bad': context_tokens has shape \(1,\), arrival_s \(2,\); give one number"),
        (([0, 1], [1, 1], [1, 1, 1]), 2.0, r"'bad': generated_tokens has shape \(3,\)"),
        (([[0, 1]], [[1, 1]], [[1, 1]]), 2.0, r"'bad': arrival_s has shape \(1, 2\)"),
        (([0, np.nan], [1, 1], [1, 1]), 2.0, r"'bad': index 1: arrival_s is nan"),
        (([-1, 0], [1, 1], [1, 1]), 2.0, r"'bad': index 0: arrival_s is -1.0; give times from 0 on"),
        (([0, 2, 1], [1, 1, 1], [1, 1, 1]), 3.0, r"'bad': index 2: arrival_s 1.0 comes after 2.0; sort"),
        (([0, 1], [1, 0], [1, 1]), 2.0, r"'bad': index 1: context_tokens is 0; give whole numbers of at least 1"),
        (([0, 1], [1, 1], [1, 1.5]), 2.0, r"'bad': index 1: generated_tokens is 1.5"),
        (([0, 1], [1, np.nan], [1, 1]), 2.0, r"'bad': index 1: context_tokens is nan"),
        (([0, 1], [1, np.inf], [1, 1]), 2.0, r"'bad': index 1: context_tokens is inf"),
        (([[0, 1]], [[1, 0]], [[1, 1]]), 2.0, r"'bad': index 1: context_tokens is 0"),
        (([0, 1], [1, 1], [1, 1]), 0.5, r"'bad': duration_s = 0.5 does not cover the arrivals; give at least 1"),
        (([], [], []), 0.0, r"'bad': duration_s = 0.0"),
        (([0], [1], [1]), np.nan, r"'bad': duration_s = nan"),
    ],
)
def test_bad_requests_are_named(columns, duration_s, message):
    with pytest.raises(TraceError, match=message):
        Requests(*map(np.asarray, columns), duration_s=duration_s, name="bad")
