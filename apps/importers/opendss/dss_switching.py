"""Switch controls, fuses, reclosers and relays: their element is in the tables in its present state.

They switch in OpenDSS over time or at fault currents. In a power flow with controls off, their element stays as it is.
"""

from __future__ import annotations

from dcgrid_env.apps.importers.opendss.dss_circuit import DssCircuit
from dcgrid_env.grid.topology import FeederError

SWITCHING = ("swtcontrol", "fuse", "recloser", "relay")
"""Classes of elements that open and close a terminal of another element."""
_OPEN = 1
"""OpenDSS's code of an open switch."""


def switch_as_asked(circuit: DssCircuit) -> None:
    """Carry out the actions of switch controls that the script asks for and OpenDSS would do at its next solution.

    ``action=open`` and ``normal=open`` wait for a solution with controls on, which the import does not make.
    """
    for name in circuit.names("swtcontrol"):
        controls = circuit.engine.SwtControls
        controls.Name(name)
        action = controls.Action()
        if action == controls.State() or controls.IsLocked():
            continue
        terminal = int(controls.SwitchedTerm())
        circuit.activate(*controls.SwitchedObj().split(".", 1))
        element = circuit.engine.CktElement
        (element.Open if action == _OPEN else element.Close)(terminal, 0)


def kept_state(circuit: DssCircuit, kind: str, name: str) -> str:
    """State in which a switching device keeps its element, as a text for the report."""
    circuit.activate(kind, name)
    element, terminal = circuit.text("switchedobj"), circuit.text("switchedterm")
    if "." not in element:
        raise FeederError(f"{kind} {name}: switchedobj is {element!r}, no element; give it, or monitoredobj")
    normal = _normal_state(circuit, kind, name)
    circuit.activate(*element.split(".", 1))
    ends = circuit.open_conductors()
    opened = ends[min(int(terminal), len(ends)) - 1]
    state = "open" if all(opened) else "partly open" if any(opened) else "closed"
    text = f"its element stays {state}, its present state; it does not trip in dcgrid"
    return text if normal == state else f"{text}; its normal state is {normal}"


def _normal_state(circuit: DssCircuit, kind: str, name: str) -> str:
    """State to which OpenDSS resets the switch of the active device."""
    if kind == "swtcontrol":  # its property has the state that it is to have next
        circuit.engine.SwtControls.Name(name)
        return "open" if circuit.engine.SwtControls.NormalState() == _OPEN else "closed"
    words = set(circuit.text("normal").strip("[]").replace(",", " ").split())
    return words.pop() if len(words) == 1 else "partly open"
