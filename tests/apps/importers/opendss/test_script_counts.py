"""Whole numbers of a script are bounded however they are written, before OpenDSS sees them."""

import json

import pytest

from dcgrid_env import FeederError
from dcgrid_env.apps.importers.opendss.reading import read_circuit

dss = pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")


@pytest.mark.parametrize("line", [
    "New Transformer.t windings=100000", "New Transformer.t WIND=20000", "New Transformer.t 3 20000",
    "New Transformer.t phases=3 20000", "New Transformer.t\n~ ph=3 20000", "New Transformer.t windings=(10 5 ^)",
    "New Transformer.t windings=$FFFF", "New Transformer.t windings=1e5", "New Transformer.t windings=-5",
    "New Transformer.t windings='20000'", "New XfmrCode.x windings=20000", "New Linecode.c nphases=20000",
    "Edit Load.d phases=20000", "Load.d.phases=20000", "BatchEdit Load..* phases=20000", "New Line.x n m c 1 20000",
    "New Capacitor.c numsteps=20000", "New LineGeometry.g nconds=20000", "New LineSpacing.s 20000",
    "New LineGeometry.g cond=20000", "New WireData.w seasons=20000", "New CNData.c k=20000",
    "New LoadShape.s npts=2000000000", "New Spectrum.s numharm=2000000000", "Vsource.source.phases=20000",
    "New RegControl.r winding=20000", "New Transformer.t numtaps=20000", "New VSConverter.v ndc=20000",
    "New Circuit.other phases=20000",
])  # fmt: skip
def test_counts_out_of_bounds_are_refused_by_line(master, line):
    with pytest.raises(FeederError, match=r"line (9|10): '[^']+' is refused: \w+ is '.*'; give a whole number from 0"):
        read_circuit(master(line))


def test_counts_within_bounds_are_read(master):
    shape = "New LoadShape.s npts=525600 interval=0.0167 mult=(1 1)"
    read_circuit(master(f"{shape}\nNew Load.x phases=3.0 bus1=n kv=12.47 numcust=2000\nNew Line.x n m c3 100000 units=m"
                        "\nOpen Line.x 1"))  # fmt: skip


def test_every_whole_number_that_opendss_has_is_checked():
    engine = dss.dss.NewContext()
    schema = engine.dss_ffi.string(engine.dss_lib.DSS_ExtractSchema(engine.dss_ffi.NULL, False)).decode()
    types = {one["type"] for kind in json.loads(schema)["classes"] for one in kind["properties"]}
    assert {name for name in types if "integer" in name.lower()} == {"Integer", "IntegerOnStructArray", "IntegerArray"}
    engine.Text.Command("New Circuit.c")
    for kind in ("transformer", "line", "load", "linecode"):
        engine.Text.Command(f"New {kind}.one")
        engine.Circuit.SetActiveElement(f"{kind}.one")
        (found,) = [one for one in json.loads(schema)["classes"] if one["name"].lower() == kind]
        assert [one["name"] for one in found["properties"]] == list(engine.Element.AllPropertyNames())
