"""Emergency and seasonal ratings of OpenDSS scripts, kept in ratings.csv."""

import math

import pytest

from dcgrid_env import ThreePhaseFeeder
from dcgrid_env.grid import with_ratings

pytest.importorskip("opendssdirect")
from dcgrid_env.apps.importers.opendss import read_opendss

SCRIPT = """
Clear
New Circuit.rated basekv=12.47 pu=1 bus1=src MVAsc3=20000 MVAsc1=20000
New LineCode.cable nphases=3 r1=0.1 x1=0.1 r0=0.1 x0=0.1 c1=0 c0=0 normamps=400 emergamps=520
New Line.coded bus1=src bus2=m linecode=cable length=1
New Line.seasonal bus1=m bus2=n r1=0.1 x1=0.1 r0=0.1 x0=0.1 c1=0 c0=0 length=1 normamps=300 seasons=2 ratings=[280 340]
New Line.plain bus1=n bus2=o r1=0.1 x1=0.1 r0=0.1 x0=0.1 c1=0 c0=0 length=1 normamps=250
New Line.default bus1=o bus2=q r1=0.1 x1=0.1 r0=0.1 x0=0.1 c1=0 c0=0 length=1
New Transformer.low phases=3 buses=(n p) conns=(delta wye) kvs=(12.47 0.48) kvas=(1000 1000) xhl=1 %r=0.1 emerghkva=1400 seasons=2 ratings=[900 1200]
New Load.d bus1=q kv=12.47 kw=300 kvar=0
New Load.e bus1=p kv=0.48 kw=100 kvar=0
Set VoltageBases=[12.47 0.48]
CalcVoltageBases
"""  # noqa: E501


@pytest.mark.slow
def test_written_ratings_are_kept_through_import_and_folder(tmp_path):
    path = tmp_path / "rated.dss"
    path.write_text(SCRIPT)
    feeder = ThreePhaseFeeder.from_network(read_opendss(path).network)
    feeder.to_csv(tmp_path / "folder")
    again = ThreePhaseFeeder.from_csv(tmp_path / "folder").network.rating
    assert repr(again) == repr(feeder.network.rating)
    rows = [tuple(row) for row in zip(again.element, again.season, again.normal, again.emergency, strict=True)]
    assert repr(rows) == repr([
        ("line coded", "", math.nan, 520.0),
        ("line seasonal", "season1", 280.0, math.nan),
        ("line seasonal", "season2", 340.0, math.nan),
        ("transformer low", "", math.nan, 1400.0),
        ("transformer low", "season1", 900.0, math.nan),
        ("transformer low", "season2", 1200.0, math.nan),
    ])  # fmt: skip
    hot, without = with_ratings(feeder, "normal", "season1")
    assert isinstance(hot, ThreePhaseFeeder)
    assert hot.network.phase_line.rating_a[:3] == (400.0, 280.0, 250.0)
    assert hot.network.transformer.rating_kva == (900.0,)
    assert without == ("line coded", "line plain")
