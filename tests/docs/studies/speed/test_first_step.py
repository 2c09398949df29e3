"""The script that measures the first step runs on this version, and against an interpreter."""

import subprocess
import sys

import pytest

from helpers.places import ROOT


@pytest.mark.slow
def test_first_step_prints_a_row_for_each_version():
    command = [sys.executable, "-m", "docs.studies.speed.first_step", "toy6", "--against", sys.executable]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in done.stdout.splitlines()[2:]]
    assert [row[:2] for row in rows] == [["`toy6`", "this version"], ["`toy6`", "the other"]]
    assert all(float(seconds) > 0.0 for row in rows for seconds in row[2:])
