"""The comparison of two versions' speeds runs, here of one version with itself."""

import subprocess
import sys

import pytest

from helpers.places import ROOT


@pytest.mark.slow
def test_one_version_with_itself():
    command = [
        sys.executable,
        "-m",
        "docs.studies.speed.paired_speed",
        sys.executable,
        "make",
        "tensor_gradient",
        "--rounds",
        "1",
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    *_, one, gradient = done.stdout.splitlines()
    assert one.startswith("| make |")
    assert gradient.startswith("| tensor_gradient |")
    assert all(line.endswith("| True |") for line in (one, gradient))
