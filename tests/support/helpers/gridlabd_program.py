"""GridLAB-D itself, as the package ``gridlabd`` runs it: an independent reading and solution of a model.

It runs in a separate process, which ends with its threads and pipes.
"""

import importlib.util
import json
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

NODES = ("node", "meter", "load", "capacitor", "triplex_node", "triplex_meter", "triplex_load")
FORMATS = {"complex_format": "%+.15lg%+.15lg%c", "double_format": "%+.15lg", "complex_output_format": "RECT"}


def properties(path, wanted):
    """Values of properties, each an object and a name, as GridLAB-D reads them from a model."""
    return dict(zip(wanted, _run("properties", path, wanted), strict=True))


def voltages(path):
    """Complex voltage of each node of a solved model by name such as ``"n1.a"``, V; legs 1 and 2 are a and b."""
    return {name: complex(*v) for name, v in _run("voltages", path, []).items()}


def _run(what, path, wanted):
    if importlib.util.find_spec("gridlabd") is None:
        pytest.skip("gridlabd is not installed (extra test, on Linux)")
    command = [sys.executable, "-W", "ignore", __file__, what, str(path), json.dumps(wanted)]
    folder = Path(path).parent  # where GridLAB-D leaves a file
    ran = subprocess.run(command, check=True, capture_output=True, text=True, timeout=60, cwd=folder)
    return json.loads(ran.stdout)


def _loaded(path):
    import gridlabd

    made = gridlabd.GridLabD()
    for name, value in FORMATS.items():
        made.global_setvar(name, value)
    assert made.load(path) == 0, made.get_messages()
    return made


def _solved_voltages(path):
    solved = _loaded(path)
    assert (solved.setup_after_load(), solved.run()) == (0, 0), solved.get_messages()
    found = {}
    for kind in NODES:
        three = {letter: (letter.upper(), 1.0) for letter in "abc"}
        legs = {"a": ("1", 1.0), "b": ("2", -1.0)} if kind.startswith("triplex") else three
        for name in solved.get_object_names_by_class(kind):
            for letter, (leg, sign) in legs.items():
                v = solved.get_property(name, f"voltage_{leg}")[1]
                v = sign * complex(v.replace("i", "j") if isinstance(v, str) else v)
                found[f"{name}.{letter}"] = (v.real, v.imag)
    return found


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    what, path, wanted = sys.argv[1:]
    if what == "voltages":
        print(json.dumps(_solved_voltages(path)))
    else:
        loaded = _loaded(path)
        print(json.dumps([loaded.get_property(item, name)[1] for item, name in json.loads(wanted)]))
