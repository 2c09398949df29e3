"""Fixtures that write scripts into a temporary folder, and the circuit that the scripts vary."""

import pytest

CIRCUIT = """
Clear
New Circuit.town basekv=12.47 pu=1.02 bus1=src angle=10 MVAsc3=200 MVAsc1=150
New Linecode.c3 nphases=3 units=mi rmatrix=(0.34 | 0.15 0.33 | 0.16 0.15 0.35) xmatrix=(1.0 | 0.5 1.1 | 0.4 0.38 1.05)
~ cmatrix=(16 | -5 15 | -3 -2 14)
New Line.l1 bus1=src.2.1.3 bus2=m.2.1.3 linecode=c3 length=2000 units=ft
New Line.l2 bus1=n bus2=m linecode=c3 length=0.5 units=km
New Load.d bus1=n conn=delta kv=12.47 kw=300 kvar=100
"""
END = """
Set VoltageBases=[12.47 4.16 0.48]
CalcVoltageBases
"""


@pytest.fixture
def master(tmp_path):
    """Writes a master file: the circuit, further lines, and the end that it needs."""

    def write(more="", circuit=CIRCUIT, end=END):
        path = tmp_path / "Master.dss"
        path.write_text(circuit + more + end)
        return path

    return write
