"""Switch controls, fuses, reclosers and relays leave their element as OpenDSS solves it; Open and Close by name."""

import pytest

from dcgrid_env import FeederError, ThreePhaseFeeder
from dcgrid_env.apps.importers.opendss.reading import read_circuit
from helpers.opendss_imports import apart_pu, voltages

dss = pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")
SWITCH = "New Line.s bus1=n bus2=far phases=3 switch=yes\nNew Load.far bus1=far kv=12.47 kw=60 kvar=20\n"
SWITCHED = "switchedobj=line.s switchedterm=1"
LARGE = "monitoredobj=line.s phasetrip=1e6 groundtrip=1e6"
DEVICES = {
    f"New SwtControl.f {SWITCHED}": "closed",
    f"New SwtControl.f {SWITCHED} action=open": "open",
    f"New SwtControl.f {SWITCHED} state=open": "open",
    f"New SwtControl.f {SWITCHED} normal=open": "open",
    f"New SwtControl.f {SWITCHED} normal=open state=closed": "closed; normal open",
    f"New SwtControl.f {SWITCHED} normal=closed state=open": "open; normal closed",
    f"New SwtControl.f {SWITCHED} action=open lock=yes": "closed; normal open",
    f"New SwtControl.f {SWITCHED} state=open lock=yes": "open",
    f"New SwtControl.f {SWITCHED} state=open\nSwtControl.f.action=close": "closed; normal open",
    f"New SwtControl.f {SWITCHED}\nOpen Line.s 1": "open; normal closed",
    f"New Recloser.f {LARGE}": "closed",
    f"New Recloser.f {LARGE} state=open": "open",
    f"New Recloser.f {LARGE} normal=open state=open": "open",
    f"New Recloser.f {LARGE} normal=open": "closed; normal open",
    f"New Recloser.f {LARGE} action=open": "open",
    f"New Recloser.f {LARGE} {SWITCHED[:-1]}2 state=open": "open",
    f"New Recloser.f {LARGE}\nOpen Line.s 2": "closed",  # its terminal is the other one
    f"New Relay.f {LARGE}": "closed",
    f"New Relay.f {LARGE} state=open": "open",
    f"New Relay.f {LARGE} normal=open state=closed": "closed; normal open",
    f"New Relay.f {LARGE} action=trip": "open",
    "New Fuse.f monitoredobj=line.s ratedcurrent=1e6": "closed",
    "New Fuse.f monitoredobj=line.s ratedcurrent=1e6 state=[open open open]": "open",
    "New Fuse.f monitoredobj=line.s ratedcurrent=1e6 normal=[open open open]": "closed; normal open",
}
"""A device, and the state in which it leaves its element, with its normal state where that is another."""


def volts_of_opendss(path):
    """Voltages after the script and a solution with controls on, V, by node."""
    engine = dss.dss.NewContext()
    for command in (f'redirect "{path}"', "set tolerance=1e-10 maxiterations=1000", "solve"):
        engine.Text.Command(command)
    flat = engine.Circuit.AllBusVolts()
    return dict(zip(engine.Circuit.AllNodeNames(), map(complex, flat[::2], flat[1::2]), strict=True))


@pytest.mark.parametrize("solve", ["", "Solve\n"])
@pytest.mark.parametrize("device", DEVICES)
def test_a_device_leaves_its_element_in_its_present_state(master, device, solve):
    path = master(f"{SWITCH}{device}\n", end=f"\nSet VoltageBases=[12.47]\nCalcVoltageBases\n{solve}")
    found = read_circuit(path, allow=["isolated"])
    [row] = [row for row in found.findings if row.names == ("f",)]
    state, _, normal = DEVICES[device].partition("; normal ")
    assert row.fate == "nothing lost"
    assert f"stays {state}, its present state; it does not trip" in row.text
    assert row.text.partition("; its normal state is ")[2] == normal
    expected = volts_of_opendss(path)
    feeder = ThreePhaseFeeder.from_network(found.network)
    is_open = abs(expected["far.1"]) < 1.0
    assert ("far" not in feeder.bus_ids) == is_open
    assert is_open == (state == "open" or "Open Line" in device)
    assert apart_pu(found) < 1e-8
    base_v = 12470 / 3**0.5
    for node, v in voltages(feeder).items():
        bus, _, letter = node.rpartition(".")
        assert abs(v - expected[f"{bus}.{'abc'.index(letter) + 1}"] / base_v) < 1e-7


def test_a_fuse_with_one_phase_open_leaves_the_others_closed(master):
    load = "Edit Load.far bus1=far.2 phases=1 kv=7.2\n"
    fuse = "New Fuse.f monitoredobj=line.s ratedcurrent=1e6 state=[open closed closed]"
    found = read_circuit(master(SWITCH + load + fuse))
    assert any("stays partly open, its present state; it does not trip in dcgrid" in row.text for row in found.findings)
    assert abs(voltages(ThreePhaseFeeder.from_network(found.network))["far.a"]) < 0.1
    assert apart_pu(found) < 1e-8


def test_a_script_in_another_mode_keeps_its_open_switches(master):
    path = master(f"{SWITCH}New Recloser.f {LARGE}\nSet mode=direct\nOpen Line.s 1\n")
    found = read_circuit(path, allow=["isolated"])
    assert "far" not in found.network.node.bus
    assert apart_pu(found) < 1e-8


def test_a_recloser_without_an_element_is_refused(master):
    with pytest.raises(FeederError, match="recloser f: switchedobj is '', no element; give it, or monitoredobj"):
        read_circuit(master("New Recloser.f"))


@pytest.mark.parametrize("line", [
    "Open Line.s 1", "open LINE.s terminal=1", "Open Line.s term=1", "Open object=Line.s Terminal=1", "Open Line.s",
    "Open Line.s 1 1\nOpen Line.s 1 2\nOpen Line.s 1 3",
    "Open Line.s terminal=1 phase=1\nOpen Line.s terminal=1 cond=2\nOpen Line.s term=1 conductor=3",
    "Open Line.s 1\nClose Line.s terminal=1\nOpen Line.s terminal=2", "Select Line.s terminal=1\nOpen Line.s 1",
])  # fmt: skip
def test_a_terminal_is_opened_by_place_or_by_name(master, line):
    found = read_circuit(master(SWITCH + line), allow=["isolated"])
    assert "far" not in found.network.node.bus
    assert apart_pu(found) < 1e-8


def test_a_phase_is_opened_by_name(master):
    one = "Edit Load.far bus1=far.1 phases=1 kv=7.2"
    found = read_circuit(master(f"{SWITCH}{one}\nOpen Line.s terminal=2 phase=3"))
    nodes = ThreePhaseFeeder.from_network(found.network).node_ids
    assert [node for node in nodes if "far" in node] == ["far.a", "far.b"]
    assert apart_pu(found) < 1e-8


@pytest.mark.parametrize(("line", "said"), [
    ("Open Line.s phase=3 terminal=2", "'phase' is not known as word 2; choose term, terminal"),
    ("Open terminal=1 Line.s", "'terminal' is not known as word 1; choose object, element"),
    ("Close Line.s 1 bus=2", "'bus' is not known as word 3; choose cond, conductor, phase"),
    ("New Fuse.f monitoredobj=line.s action=open", r"damages OpenDSS's memory; write state=\(open open open\)"),
    ("Open Line.s 1 1 1", "'1' is one word too many; write open class.name terminal phase"),
])  # fmt: skip
def test_words_that_opendss_misreads_are_refused(master, line, said):
    with pytest.raises(FeederError, match=said):
        read_circuit(master(SWITCH + line))
