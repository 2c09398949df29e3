"""Files of users: regular ones of a bounded size, with values nested to a bound."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from dcgrid_env import FeederError, ScenarioError, make_scenario
from dcgrid_env.agents import Card, Policy
from dcgrid_env.agents.policy.neural_network import PolicyError
from dcgrid_env.apps.hosting.connection_study.study_command import read_request
from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.matpower import read_matpower
from dcgrid_env.apps.importers.pandapower.net_json import net_from_json
from dcgrid_env.apps.importers.power_grid_model import read_power_grid_model
from dcgrid_env.baselines.hindsight_costs import read_hindsight
from dcgrid_env.baselines.scenario_spec import read_value
from dcgrid_env.baselines.tuning.tuned import read_tuned
from dcgrid_env.baselines.user_code import CodeReference, load
from dcgrid_env.cli.stored_run import stored_run
from dcgrid_env.core.user_files import parse_json, parse_toml, read_bytes, read_json, read_text
from dcgrid_env.grid.formats.csv_folder import read_csv
from dcgrid_env.grid.formats.three_phase_folder import read_folder
from dcgrid_env.traces import TraceError
from dcgrid_env.traces.by_name import recorded_trace
from dcgrid_env.traces.logs.power_json import read_power_json
from dcgrid_env.traces.profile_file import read_classes, read_profiles
from dcgrid_env.traces.text.csv_file import read_csv as read_trace


class SomeError(ValueError):
    """An error of a caller."""


def in_folder(read, name):
    """A reader of a folder that has the file under a name, next to a sound feeder.toml."""

    def reading(path):
        folder = path.with_name("folder")
        folder.mkdir()
        head = 'name = "f"\nbase_kv = 10.0\nsubstation = "1"\nv0_pu = 1.0\n'
        if name != "feeder.toml":
            (folder / "feeder.toml").write_text(head)
        (folder / name).symlink_to(path)
        return read(folder)

    return reading


READERS = {
    "scenario": (make_scenario, ".toml", ScenarioError),
    "study": (read_request, ".toml", ValueError),
    "feeder.toml": (in_folder(read_csv, "feeder.toml"), ".toml", FeederError),
    "buses.csv": (in_folder(read_csv, "buses.csv"), ".csv", FeederError),
    "three-phase": (in_folder(read_folder, "feeder.toml"), ".toml", FeederError),
    "matpower": (read_matpower, ".m", FeederError),
    "power-grid-model": (read_power_grid_model, ".json", FeederError),
    "pandapower": (lambda path: net_from_json(path, Report()), ".json", FeederError),
    "trace": (lambda path: recorded_trace(str(path)), ".csv", TraceError),
    "read_csv": (read_trace, ".csv", TraceError),
    "power JSON": (read_power_json, ".json", TraceError),
    "profiles": (read_profiles, ".csv", TraceError),
    "classes": (read_classes, ".csv", TraceError),
    "tuned": (read_tuned, ".json", ValueError),
    "card": (Card.load, ".json", PolicyError),
    "policy": (Policy.load, ".safetensors", PolicyError),
    "hindsight": (lambda path: read_hindsight(path.parent, path.stem), ".json", ValueError),
    "results": (lambda path: stored_run(path.parent, False), ".json", ValueError),
    "code": (lambda path: load(CodeReference(str(path), "make"), "controller"), ".py", ValueError),
}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no pipes with a name")
@pytest.mark.parametrize("kind", ["pipe", "device", "socket"])
@pytest.mark.parametrize("reader", READERS)
def test_only_regular_files_are_opened(reader, kind, tmp_path):
    read, suffix, error = READERS[reader]
    path = tmp_path / f"{'results' if reader == 'results' else 'x'}{suffix}"
    with socket.socket(socket.AF_UNIX) as listener:
        if kind == "pipe":
            os.mkfifo(path)
        elif kind == "device":
            path.symlink_to("/dev/zero")
        else:
            os.chdir(tmp_path)  # a socket's path is short
            listener.bind(path.name)
        with pytest.raises(error, match=rf"{suffix} is a {kind}; write its content to a file") as found:
            read(path)
    assert "\n" not in str(found.value)


DEEP_JSON = '{"a": ' * 1200 + "1" + "}" * 1200
DEEP_TOML = "a = " + "[" * 1200 + "]" * 1200
DOTTED = ".".join(["a"] * 1200) + " = 1"


@pytest.mark.parametrize("reader", [name for name, (_, suffix, _) in READERS.items() if suffix in (".toml", ".json")])
def test_deep_values_are_one_line_with_the_file(reader, tmp_path):
    read, suffix, error = READERS[reader]
    for text in (DEEP_JSON,) if suffix == ".json" else (DEEP_TOML, DOTTED):
        path = tmp_path / f"{'results' if reader == 'results' else 'x'}{suffix}"
        path.write_text(text)
        with pytest.raises(error, match=rf"{suffix}\b.*nested more than 64 deep") as found:
            read(path)
        assert "\n" not in str(found.value)
        if (tmp_path / "folder").exists():
            break


@pytest.mark.parametrize("depth", [63, 65, 1200])
def test_the_depth_that_is_read(depth):
    nested = "[" * depth + "]" * depth
    if depth < 64:
        assert parse_json(nested, "x", SomeError, "") == parse_toml(f"a = {nested}", "x", SomeError)["a"]
        return
    with pytest.raises(SomeError, match=r"^x: its values are nested more than 64 deep; mend it"):
        parse_json(nested, "x", SomeError, "mend it")
    with pytest.raises(SomeError, match=r"^x: its values are nested more than 64 deep; write them without"):
        parse_toml(f"a = {nested}", "x", SomeError)
    with pytest.raises(ValueError, match=r"^set: field is '\[\[.*\.\.\., which can be read neither as TOML nor as"):
        read_value("field", "[" * 1200 + "]" * 1200)


@pytest.mark.parametrize("make", [lambda inner: [inner], lambda inner: {"a": inner}, lambda inner: (inner,)])
@pytest.mark.parametrize("field", ["sensing.noise_pu", "devices", "trace", "faults", "name", "cost", "feeder"])
def test_a_scenario_refuses_deep_values(field, make):
    value = 1
    for _ in range(5000):
        value = make(value)
    with pytest.raises(ScenarioError, match=rf"^{field} is nested more than 64 deep"):
        make_scenario("toy6", **{field: value})
    circle: list = []
    circle.append(circle)
    with pytest.raises(ScenarioError, match=rf"^{field} is nested more than 64 deep"):
        make_scenario("toy6").replace(**{field: circle})


def test_a_file_beyond_the_limit_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "large.json"
    with path.open("wb") as file:
        file.truncate(2**40)  # without content on the disk
    with pytest.raises(SomeError, match=r"large\.json has more than 512 MiB"):
        read_bytes(path, SomeError)
    path.write_bytes(b"x" * (2**20 + 1))
    with pytest.raises(SomeError, match=r"large\.json has more than 1 MiB"):
        read_bytes(path, SomeError, most_mib=1)
    path.write_bytes(b"x" * 2**20)
    assert len(read_bytes(path, SomeError, most_mib=1)) == 2**20


def test_what_is_read_is_what_is_there(tmp_path):
    path = tmp_path / "a.json"
    path.write_bytes(b'\xef\xbb\xbf{"a":\r\n "\xc3\xa4"}\r')
    assert read_text(path, SomeError) == '{"a":\n "ä"}\n'
    assert read_json(path, SomeError, "") == {"a": "ä"}
    link = tmp_path / "link.json"
    link.symlink_to(path)
    assert read_bytes(link, SomeError) == path.read_bytes()
    path.write_bytes(b"")
    assert read_bytes(path, SomeError) == b""
    path.write_bytes(b"\xff")
    with pytest.raises(SomeError, match=r"a\.json: .*; save it as UTF-8"):
        read_text(path, SomeError)
    with pytest.raises(IsADirectoryError):
        read_bytes(tmp_path, SomeError)
    with pytest.raises(FileNotFoundError):
        read_bytes(tmp_path / "none", SomeError)
    with pytest.raises(SomeError, match="'x' is there twice; leave one out"):
        parse_json('[{"x": 1, "y": 2, "x": 3}]', "f", SomeError, "")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/proc is of Linux")
def test_a_file_of_the_system_is_bounded():
    path = Path("/proc/self/status")  # its status says that it has 0 bytes
    assert "Name" in read_text(path, SomeError)
    with pytest.raises(SomeError, match="has more than 0 MiB"):
        read_bytes(path, SomeError, most_mib=0)


@pytest.mark.slow
def test_a_process_substitution_has_a_remedy():
    command = f'"{sys.executable}" -m dcgrid_env.cli traces check <(echo 1,2)'
    ran = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60)
    assert ran.returncode == 2
    assert "is a pipe; write its content to a file and give the path of that file" in ran.stderr
