"""Power flows of torch tensors on a device: every form in every precision, and its error."""

import pytest

pytest.importorskip("torch", reason="torch is not installed (the extra agents has it)")
from dcgrid_env import make_scenario
from docs.studies.speed import device_power_flows, tensors
from docs.studies.speed.device_power_flows import device_power_flow_rows
from docs.studies.speed.power_flow_rates import Case
from docs.studies.speed.three_phase_rates import ThreePhaseCase


@pytest.fixture(scope="module")
def cases():
    return Case.draw(make_scenario("toy6"), 6), ThreePhaseCase.draw(6, "ieee13-3ph")


@pytest.mark.slow
def test_every_form_is_measured_in_both_precisions(cases, monkeypatch):
    done = []
    monkeypatch.setattr(tensors, "rate", lambda work, amount, seconds: done.append(work()) or amount)
    rows = list(device_power_flow_rows(cases[0], cases[1], "cpu", 0.01))
    assert len({row.name for row in rows}) == len(rows) == len(done) == 12
    assert {row.value for row in rows} == {6}
    for row in rows:
        assert ("derivative" in row.name) == (row.error_pu is None)
        if row.error_pu is not None:
            assert row.error_pu < (1e-7 if "float64" in row.name else 1e-4), row.name


@pytest.mark.slow
def test_other_devices_have_the_array_form_alone(cases, monkeypatch):
    monkeypatch.setattr(device_power_flows, "kind_of", lambda device: "cuda")
    monkeypatch.setattr(tensors, "rate", lambda work, amount, seconds: amount)
    names = [row.name for row in device_power_flow_rows(cases[0], cases[1], "cpu", 0.01)]
    assert len(names) == 8
    assert not any("array operations" in name for name in names)
