import os
import re
import signal
import socket
import subprocess
import sys
import threading

import pytest

from dcgrid_env.core.lock import LockedError, alone, locked

HOLDER = """
import sys, time
from pathlib import Path
from dcgrid_env.core.lock import locked
with locked(Path(sys.argv[1]), "training"):
    print("holds", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path):
    """Another process that holds tmp_path."""
    process = subprocess.Popen([sys.executable, "-c", HOLDER, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "holds\n"
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


@pytest.mark.slow
def test_who_is_refused_is_told_by_whom_on_one_line(tmp_path, holder):
    with pytest.raises(LockedError) as refused, locked(tmp_path, "training"):
        pytest.fail("held twice")
    said = str(refused.value)
    assert said.startswith(f"{tmp_path}: another training (process {holder.pid} on {socket.gethostname()}, since 2")
    assert said.endswith(") writes there; give another --out, or wait until it has ended")
    assert "\n" not in said


@pytest.mark.parametrize("sign", [signal.SIGKILL, signal.SIGINT])
@pytest.mark.slow
def test_a_lock_ends_with_its_process(tmp_path, holder, sign):
    holder.send_signal(sign)
    holder.wait()
    with locked(tmp_path, "training"):
        assert str(os.getpid()) in (tmp_path / ".lock.json").read_text()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("error", [None, KeyboardInterrupt, ValueError])
def test_nothing_of_a_lock_is_left_behind(tmp_path, error):
    try:
        with locked(tmp_path, "training"):
            with pytest.raises(LockedError, match=re.escape(f"process {os.getpid()} ")), locked(tmp_path, "training"):
                pass
            if error:
                raise error
    except (KeyboardInterrupt, ValueError):
        pass
    assert not list(tmp_path.iterdir())


def test_no_two_hold_a_lock_that_is_deleted_and_made_anew(tmp_path):
    inside, most = [], []

    def again_and_again():
        for _ in range(50):
            with alone(tmp_path / "lock"):
                inside.append(1)
                most.append(len(inside))
                inside.pop()

    threads = [threading.Thread(target=again_and_again) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(most) == 150
    assert max(most) == 1
    assert not list(tmp_path.iterdir())
