"""Public circuits are imported as they are published, and agree with OpenDSS's own solution."""

import pytest

from dcgrid_env import ThreePhaseFeeder
from dcgrid_env.apps.importers.opendss.reading import read_circuit
from helpers.opendss_imports import apart_pu
from helpers.places import SHARED_CIRCUITS

dss = pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")

SMALL = {
    "IEEETestCases/37Bus/ieee37.dss": 5e-8,
    "IEEETestCases/4Bus-GrdYD-Bal/4Bus-GrdYD-Bal.DSS": 1e-8,
    "IEEETestCases/4Bus-OYOD-Bal/4Bus-OYOD-Bal.DSS": 1e-8,
    "IEEETestCases/4Bus-OYOD-UnBal/4bus-OYOD-UnBal.dss": 1e-8,
    "IEEETestCases/4Bus-YD-Bal/4Bus-YD-Bal.DSS": 1e-8,
    "IEEETestCases/4Bus-YYD/YYD-Master.DSS": 2e-7,
    "IEEETestCases/NEVTestCase/NEVMASTER.DSS": 1e-8,
}
LARGE = {
    "IEEETestCases/8500-Node/Master.dss": 3e-7,
    "IEEETestCases/8500-Node/Master-unbal.dss": 3e-7,
    "EPRITestCircuits/ckt5/Master_ckt5.dss": 2e-7,
    "EPRITestCircuits/ckt7/Master_ckt7.dss": 2e-7,
    "EPRITestCircuits/epri_dpv/K1/Master_NoPV.dss": 2e-8,
    "EPRITestCircuits/epri_dpv/M1/Master_NoPV.dss": 1e-7,
}
"""Largest difference of a voltage, p.u.; OpenDSS solves to 1e-10."""


@pytest.mark.parametrize("path", [*SMALL, *(pytest.param(path, marks=pytest.mark.slow) for path in LARGE)])
@pytest.mark.slow
def test_a_published_circuit_agrees_with_opendss(path):
    if not SHARED_CIRCUITS.is_dir():
        pytest.skip("the public circuits of ../shared are not there")
    found = read_circuit(SHARED_CIRCUITS / path, root=SHARED_CIRCUITS)
    assert not [row for row in found.findings if row.fate == "lost"]
    assert not ThreePhaseFeeder.from_network(found.network).is_radial or "ckt7" in path or "M1" in path
    assert apart_pu(found) < (SMALL | LARGE)[path]
