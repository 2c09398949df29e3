"""Closed standard streams, a reader that stops and a full device end without a traceback."""

import os
import subprocess
import sys

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not os.path.exists("/dev/full"), reason="the system has no /dev/full"),
]


def shell(command):
    """Run a command line of bash with the program for ``dcgrid``."""
    line = command.replace("dcgrid", f'"{sys.executable}" -m dcgrid_env.cli', 1)
    return subprocess.run(["bash", "-c", line], capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize(
    ("words", "status"), [("list scenarios", 0), ("--help", 0), ("--version", 0), ("nonsense", 2), ("run --seed -1", 2)]
)
@pytest.mark.parametrize("streams", [">&-", "2>&-", "<&- >&- 2>&-", "2>/dev/full"])
def test_a_closed_stream_changes_no_status(words, status, streams):
    ran = shell(f"dcgrid {words} {streams}")
    assert ran.returncode == status
    assert "Traceback" not in ran.stderr


@pytest.mark.parametrize("words", ["list scenarios", "--help", "--version"])
def test_a_full_device_is_one_line(words):
    ran = shell(f"dcgrid {words} >/dev/full")
    assert ran.returncode == 2
    assert ran.stderr.startswith("dcgrid: [Errno 28]")
    assert ran.stderr.count("\n") == 1


def test_a_reader_that_stops_ends_the_command_as_the_shell_does():
    ran = shell("dcgrid list | true; echo ${PIPESTATUS[0]}")
    assert ran.stdout == "141\n"
    assert ran.stderr == ""


@pytest.mark.parametrize("content", [b"[dcgrid.controllers]\nno sign of equality\n", b"\xff\xfe"])
def test_another_package_with_malformed_entry_points_is_one_warning(content, tmp_path):
    folder = tmp_path / "broken-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_bytes(content)
    ran = shell(f"PYTHONPATH={tmp_path} dcgrid list controllers")
    assert ran.returncode == 0
    assert "droop" in ran.stdout
    assert ran.stderr.count("PluginWarning: the entry points of broken 1.0 cannot be read") == 1
