"""No compiled kernel reads or writes outside an array: small cases of all kernels with every index checked."""

import ast
import os
import subprocess
import sys

import pytest

from helpers.places import ROOT

FOLDERS = {"dcgrid_env": "dcgrid_env", "baselines": "dcgrid_env.baselines", "agents": "dcgrid_env.agents"}
FOLDERS |= {"traces": "dcgrid_env.traces"}


def kernel_modules():
    """Modules that import the compiler, or one of ours that does: all in which a kernel can be defined."""
    imported = {}
    for folder, package in FOLDERS.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            dotted = ".".join([package, *path.relative_to(ROOT / folder).with_suffix("").parts])
            names = set()
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Import):
                    names |= {alias.name for alias in node.names}
                elif isinstance(node, ast.ImportFrom):
                    names |= {f"{node.module}", *(f"{node.module}.{alias.name}" for alias in node.names)}
            imported[dotted.removesuffix(".__init__")] = names
    direct = {module for module, names in imported.items() if "numba" in names}
    return sorted(direct | {module for module, names in imported.items() if names & direct})


@pytest.mark.slow
def test_small_cases_of_every_kernel_stay_within_their_arrays(tmp_path):
    checks = {"NUMBA_BOUNDSCHECK": "1", "NUMBA_OPT": "0", "NUMBA_CACHE_DIR": str(tmp_path)}
    places = {"PYTHONPATH": str(ROOT / "tests" / "support"), "DCGRID_NUM_THREADS": "2"}
    child = subprocess.run(
        [sys.executable, "-W", "ignore", "-m", "helpers.kernel_cases", *kernel_modules()],
        env=os.environ | checks | places, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert child.returncode == 0, child.stderr
    missed = child.stdout.split()
    assert not missed, f"no case runs {', '.join(missed)}; add one to tests/support/helpers/kernel_cases.py"
