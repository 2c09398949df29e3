"""Rows made when they are needed are those that the library makes."""

import numpy as np
import pytest

from dcgrid_env.traces import RowsOnDemand, TraceError, library


@pytest.mark.parametrize("source", ["training", "chat"])
def test_a_row_is_the_librarys(source):
    rows = RowsOnDemand(source, "test", 2.0, 400.0, 5, 1.2, spare_steps=7)
    assert rows.spare_steps == 7
    assert np.isnan(rows.p_share).all()
    assert rows.provenance == ()
    rows.make(np.array([[3, 1], [1, 1]]))
    wanted = library(source, "test", 2.0, 400.0, 5, 1.2)
    assert wanted.compute_share is not None
    for row in (1, 3):
        np.testing.assert_array_equal(rows.p_share[row], wanted.p_share[row])
        np.testing.assert_array_equal(rows.compute_share[row], wanted.compute_share[row])
        if source == "chat":
            np.testing.assert_array_equal(rows.requests[row].arrival_s, wanted.requests[row].arrival_s)
    assert np.isnan(rows.p_share[[0, 2, 4]]).all()
    assert rows.provenance == (wanted.provenance[1], wanted.provenance[3])
    assert set(rows.requests) == ({1, 3} if source == "chat" else set())


def test_a_row_that_was_made_is_not_made_again():
    rows = RowsOnDemand("inference", "train", 1.0, 100.0, 3, 1.0, 0)
    rows.make(np.array([2]))
    rows.p_share[2] = 0.5
    rows.make(np.array([2]))
    assert (rows.p_share[2] == 0.5).all()


def test_rows_that_follow_the_day_say_at_which_hour_they_begin():
    rows = RowsOnDemand("chat", "test", 1.0, 60.0, 30, 1.0, 0)
    assert rows.begin_h is not None
    assert rows.begin_h.tolist() == [(2_000_000 + row) % 24 for row in range(30)]
    rows.make(np.array([4]))
    assert rows.provenance[0].parameters["hour"] == rows.begin_h[4]
    assert RowsOnDemand("inference", "test", 1.0, 60.0, 3, 1.0, 0).begin_h is None


def test_what_cannot_be_is_refused_as_the_library_does():
    with pytest.raises(TraceError, match="no trace source 'nuclear'; `dcgrid list traces` lists all"):
        RowsOnDemand("nuclear", "test", 1.0, 60.0, 3, 1.0, 0)
    with pytest.raises(TraceError, match="'step' has no split 'ood'"):
        RowsOnDemand("step", "ood", 1.0, 60.0, 3, 1.0, 0)
