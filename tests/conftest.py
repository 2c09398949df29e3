"""Settings of all tests."""

import os
import signal
import sys
from pathlib import Path

from hypothesis import settings

if "PYTEST_XDIST_WORKER" in os.environ:
    # Workers share the cores: threads of one's torch would wait for those of the others'.
    os.environ.setdefault("OMP_NUM_THREADS", "1")

# Workers and the commands that tests start would each compile all modules from their text without files of byte code.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# A verifier's own key, in the home of whoever runs the tests, signs no report here.
os.environ["DCGRID_VERIFIER_KEY"] = str(Path(__file__).with_name("no-verifier.key"))

# The same examples at every run, and no limit on an example's time: a busy machine is no failure.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell starts its background commands so, and they pass it on to the commands whose interruption is tested.
    signal.signal(signal.SIGINT, signal.default_int_handler)

COMPILED = {"gw0": ("toy6",), "gw1": ("ieee34-3ph", "routing", "ride-through")}
"""Presets whose kernels a worker compiles before its first test where none have been: both would compile all else."""


def pytest_sessionstart(session):
    """Compile where nothing has been, a part in each of two workers, for the other to read from the disk."""
    presets = COMPILED.get(os.environ.get("PYTEST_XDIST_WORKER", ""), ())
    if not presets:
        return
    from dcgrid_env import DcgridVectorEnv, make_scenario
    from dcgrid_env.core.kernel_files import folders

    if any(any(folder.glob("sweep_rows-*")) for folder in folders()):
        return

    for preset in presets:
        env = DcgridVectorEnv(2, make_scenario(preset, split="test", horizon=5))
        env.reset(seed=0)
        env.step(env.action_space.sample())
