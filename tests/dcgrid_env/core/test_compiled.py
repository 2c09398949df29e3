"""The cache of compiled kernels in separate processes: which kernels are loaded or recompiled, and its folder."""

import os
import re
import subprocess
import sys
import time

import pytest

from dcgrid_env.core.compiled import compiled
from dcgrid_env.core.kernel_files import UNUSED_S
from helpers.places import ROOT

CONSTANT = "FACTOR = {factor}\n"
CALLEE = """
from constant import FACTOR
from dcgrid_env.core.compiled import compiled

@compiled
def times(x):
    return {body}
"""
KERNEL = """
from callee import times
from dcgrid_env.core.compiled import compiled

@compiled
def last(x):
    return times(x[3])
"""
RUN = """
import sys
import numpy as np
from numba.core import event
compilations = []
class Listener(event.Listener):
    def on_start(self, e): compilations.append(e)
    def on_end(self, e): pass
event.register("numba:compile", Listener())
from kernel import last
print(last(np.arange(4.0)), len(compilations))
"""


PAIR = """
from typing import NamedTuple

class Pair(NamedTuple):
    a: float
    b: float
"""
OF_PAIR = """
from {module} import Pair
from dcgrid_env.core.compiled import compiled

@compiled
def first(pair):
    return 2.0 * pair.a
"""
RUN_OF_PAIR = RUN.replace("last(np.arange(4.0))", "first(Pair(3.0, 2.0))").replace("last", "Pair, first")


class Kernels:
    """Three small modules, and the processes that run their kernel."""

    def __init__(self, folder):
        self.folder = folder
        self.cache = folder / "cache"
        self.write()

    def write(self, factor=2, body="FACTOR * x"):
        for name, text in (
            ("constant", CONSTANT.format(factor=factor)),
            ("callee", CALLEE.format(body=body)),
            ("kernel", KERNEL),
        ):
            path = self.folder / f"{name}.py"
            path.write_text(text)
            os.utime(path, (1e9, 1e9))  # the same time at each change

    def files(self):
        return sorted(self.cache.rglob("*.kernel"))

    def run(self, script=RUN, **variables):
        """What the kernel returned, how many compilations that took, and stderr."""
        env = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")}
        env |= {"NUMBA_CACHE_DIR": str(self.cache), "PYTHONDONTWRITEBYTECODE": "1"} | variables
        env["PYTHONPATH"] = str(self.folder)
        command = [sys.executable, "-W", "error", "-c", script]
        done = subprocess.run(command, env=env, cwd=self.folder, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        value, compilations = done.stdout.split()
        return float(value), int(compilations), done.stderr


@pytest.fixture
def kernels(tmp_path):
    return Kernels(tmp_path)


@pytest.mark.slow
def test_what_is_compiled_is_loaded_until_a_callee_or_constant_in_another_file_changes(kernels):
    assert kernels.run()[:2] == (6.0, 2)
    assert kernels.run()[:2] == (6.0, 0)
    kernels.write(factor=3)  # neither the kernel's file nor any file's size or time changes
    assert kernels.run()[:2] == (9.0, 2)
    kernels.write(factor=3, body="FACTOR + x")
    assert kernels.run()[:2] == (6.0, 2)
    kernels.write(factor=2)
    assert kernels.run()[:2] == (6.0, 0)  # the first code is still there
    assert not list(kernels.folder.rglob("*.nb[ic]"))


@pytest.mark.slow
@pytest.mark.parametrize("content", [b"", b"junk", None], ids=["empty", "junk", "cut"])
def test_a_damaged_file_is_compiled_again(kernels, content):
    kernels.run()
    for path in kernels.files():
        path.write_bytes(path.read_bytes()[:-7] if content is None else content)
    assert kernels.run()[:2] == (6.0, 2)
    assert kernels.run()[:2] == (6.0, 0)


@pytest.mark.slow
def test_a_named_tuple_that_moved_to_another_module_is_compiled_again(kernels):
    for module, compilations in (("here", 1), ("there", 1), ("there", 0)):
        (kernels.folder / "here.py").unlink(missing_ok=True)
        (kernels.folder / f"{module}.py").write_text(PAIR)
        (kernels.folder / "kernel.py").write_text(OF_PAIR.format(module=module))
        assert kernels.run(RUN_OF_PAIR)[:2] == (6.0, compilations)


@pytest.mark.slow
def test_settings_of_numba_that_change_the_code_have_files_of_their_own(kernels):
    kernels.run()
    assert kernels.run(NUMBA_BOUNDSCHECK="1")[1] == 2
    assert kernels.run(NUMBA_BOUNDSCHECK="1")[1] == 0
    assert kernels.run()[1] == 0
    assert kernels.run(NUMBA_DISABLE_JIT="1")[:2] == (6.0, 0)


@pytest.mark.slow
def test_files_that_nobody_has_read_for_long_are_deleted_where_others_are_written(kernels):
    kernels.run()
    used, *_ = kernels.files()
    long_ago = time.time() - UNUSED_S - 60
    left = used.with_name("left.kernel")
    for path in (used, left):
        path.write_bytes(used.read_bytes())
        os.utime(path, (long_ago, long_ago))
    kernels.run()
    assert left.exists()  # nothing was written
    kernels.write(factor=4)
    kernels.run()
    assert used.exists()
    assert not left.exists()


_THING = object()


def _of_an_object():
    return _THING


def test_a_kernel_that_uses_what_has_no_lasting_text_is_refused():
    with pytest.raises(TypeError, match="_THING is a object"):
        compiled(_of_an_object)()


def test_a_kernel_that_only_others_call_refuses_a_call_from_python():
    with pytest.raises(TypeError, match="_twice is a kernel that only other kernels call"):
        _twice(2.0)
    assert _four_times(2.0) == 8.0
    with pytest.raises(TypeError, match="_twice is a kernel that only other kernels call"):
        _twice(2.0)


@compiled(inner=True)
def _twice(x):
    return 2.0 * x


@compiled
def _four_times(x):
    return _twice(_twice(x))


def test_every_kernel_is_compiled_by_the_one_decorator():
    folders = ("dcgrid_env", "baselines", "agents", "traces", "apps")
    for path in (path for folder in folders for path in (ROOT / folder).rglob("*.py")):
        if path.name != "compiled.py" or path.parent.name != "core":
            assert not re.search(r"njit|@jit|cache=True\)$", path.read_text(), re.MULTILINE), path


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="a folder has no permissions for others there")
def test_a_folder_that_others_can_write_is_not_read(kernels):
    kernels.run()
    (folder,) = {path.parent for path in kernels.files()}
    assert folder.stat().st_mode & 0o777 == 0o700
    assert kernels.run()[:2] == (6.0, 0)
    folder.chmod(0o777)
    temporary = kernels.folder / "temporary"
    temporary.mkdir()
    value, compilations, stderr = kernels.run(TMPDIR=str(temporary))
    assert (value, compilations) == (6.0, 2)
    assert f"{folder}: belongs to another user or can be written by others; using {temporary}" in stderr
