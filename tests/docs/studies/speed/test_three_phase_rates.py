"""The three-phase rows of the speed table: their errors, and OpenDSS where it is installed."""

import numpy as np
import pytest

from docs.studies.speed.power_flow_rates import MISSING
from docs.studies.speed.three_phase_rates import ThreePhaseCase, three_phase_reference_rows, three_phase_rows


@pytest.fixture
def case():
    return ThreePhaseCase.draw(20, "ieee13-3ph")


def test_every_rate_has_its_error(case):
    rows = list(three_phase_rows(case, 0.01))
    assert len({row.name for row in rows}) == len(rows) == 4
    assert all(row.value is not None and row.value > 0.0 for row in rows)
    assert all(row.error_pu < 1e-8 for row in rows[:3] if row.error_pu is not None)
    assert case.error_pu(case.v_pu[:3] + 1e-3) == pytest.approx(1e-3)


def test_other_libraries_solve_the_same_points(case):
    for module in ("dss", "power_grid_model"):
        pytest.importorskip(module, reason=f"{module} is not installed (the extra bench has it)")
    rows = list(three_phase_reference_rows(case, 0.01))
    assert len({row.name for row in rows}) == len(rows) == 4
    for row in rows:
        assert row.error_pu is not None
        assert row.error_pu < 1e-6


def test_a_library_that_is_not_installed_is_said_to_be(case, monkeypatch):
    monkeypatch.setattr("docs.studies.speed.three_phase_rates.find_spec", lambda name: None)
    assert [(row.value, row.unit) for row in three_phase_reference_rows(case, 0.01)] == [(None, MISSING)] * 3


def test_points_are_the_same_at_each_call(case):
    np.testing.assert_array_equal(ThreePhaseCase.draw(20, "ieee13-3ph").p_kw, case.p_kw)
