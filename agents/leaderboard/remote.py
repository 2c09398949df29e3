"""Controllers of other processes: what a scope sends goes over a socket, actions come back."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import pickle
import signal
import site
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import numpy as np

from dcgrid_env import RegulatorState, Scenario, action_layout, field_names
from dcgrid_env.agents.leaderboard.controller_process import (
    ACT,
    DONE,
    FAILED,
    LOAD,
    MEASURE,
    PLACE,
    RESET,
    Code,
    Loading,
    Part,
    receive,
    send,
)
from dcgrid_env.agents.leaderboard.entry_files import SubmissionError
from dcgrid_env.agents.leaderboard.scopes import Scope
from dcgrid_env.baselines import Controller
from dcgrid_env.baselines.rollout import ControllerError

START_S, STEP_S = 600.0, 60.0
"""Most time for an answer, and for a step of code of a submitter, by the clock."""
LONGEST_ERROR = 8000
"""Most bytes of an error's text."""
LONGEST_LINE = 300
"""Most letters of the last line that a process wrote before it ended."""
_SINGLE_THREADED = ("OMP", "OPENBLAS", "MKL", "NUMBA", "DCGRID")


class ProcessError(RuntimeError):
    """A controller's process failed, took too long, or sent an invalid answer."""


class ControllerProcess:
    """A process that runs one controller at a time.

    Parameters
    ----------
    of_submitter
        Whether it runs code of a submitter, in a separate folder and without this process's environment variables.
    """

    def __init__(self, of_submitter: bool = False):
        self._folder = tempfile.TemporaryDirectory(prefix="dcgrid-entry-") if of_submitter else None
        self._channel, other = socket.socketpair()
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115, closed by close()
        module = "dcgrid_env.agents.leaderboard.controller_process"
        folder = None if self._folder is None else self._folder.name
        with other:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", module, str(other.fileno())], pass_fds=[other.fileno()],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=self._errors,
                env=_environment(folder), cwd=folder, start_new_session=True,
            )  # fmt: skip

    def load(self, spec: str, scenario: Scenario, tuned: Path, code: bytes | None, confined: bool) -> None:
        """Have it make a controller, see ``remote``."""
        folder = Path.cwd() if self._folder is None else Path(self._folder.name)
        submitted = None if code is None or self._folder is None else Code(code, confined)
        self.ask(LOAD, pickle.dumps(Loading(spec, pickle.dumps(scenario), tuned, folder, submitted)))

    def ask(self, name: bytes, content: bytes, n_bytes: int = 0) -> bytes:
        """Send a message and give the answer, of so many bytes.

        Raises
        ------
        ProcessError
            If no such answer arrives in time.
        ValueError
            If the controller refuses the scenario.
        """
        limit_s = STEP_S if name in (ACT, MEASURE) and self._folder is not None else START_S
        try:
            self._channel.settimeout(limit_s)
            send(self._channel, name, content)
            answer, content = receive(self._channel, max(n_bytes, LONGEST_ERROR), limit_s)
        except TimeoutError:
            self.close()
            raise ProcessError(f"its process gave no answer within {limit_s:g} s") from None
        except (OSError, EOFError):
            raise ProcessError(f"its process ended ({self._ended()})") from None
        except ValueError as error:
            self.close()
            raise ProcessError(f"its process gave no answer: {error}") from None
        if answer == FAILED:
            raise _reported_error(content)
        if answer != DONE or len(content) != n_bytes:
            self.close()
            raise ProcessError(f"its process sent {len(content)} bytes, expected {n_bytes}")
        return content

    def _ended(self) -> str:
        """How the process ended, and the last line of its standard error."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=5.0)  # a process that ends by itself has a status to report
        length = os.fstat(self._errors.fileno()).st_size
        lines = os.pread(self._errors.fileno(), LONGEST_ERROR, max(length - LONGEST_ERROR, 0)).splitlines()
        self.close()
        code = self._process.returncode
        ending = f"signal {-code}" if code < 0 else f"exit status {code}"
        last = _printable(lines[-1].decode(errors="replace"))[:LONGEST_LINE] if lines else ""
        return f"{ending}: {last}" if last else ending

    @property
    def runs(self) -> bool:
        """Whether it runs and can receive messages."""
        return self._process.poll() is None and self._channel.fileno() >= 0

    def close(self) -> None:
        """End the process and those of its group, and delete its folder."""
        self._channel.close()
        self._errors.close()
        if self._process.returncode is None:  # afterwards its number may be that of another process
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        if self._folder is not None:
            self._folder.cleanup()


def require_system() -> None:
    """SubmissionError on a system without the processes of Unix."""
    if sys.platform == "win32":
        raise SubmissionError("the leaderboard runs entries in processes that need Linux; use Linux, such as in WSL")


def _environment(folder: str | None) -> dict[str, str]:
    """Environment variables of a process: this one's, or a few for a process that runs in its own folder."""
    environment = {f"{name}_NUM_THREADS": "1" for name in _SINGLE_THREADED}
    if folder is None:
        environment |= {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    else:
        environment |= {"PATH": os.defpath, "HOME": folder, "TMPDIR": folder, "NUMBA_CACHE_DIR": folder}
    user = {"PYTHONUSERBASE": site.getuserbase()} if site.ENABLE_USER_SITE else {"PYTHONNOUSERSITE": "1"}
    return environment | user | {"PYTHONPATH": os.pathsep.join(import_path())}


def import_path() -> list[str]:
    """Python's import path, without the folders of the script and of the work, which code of a submitter may not read.

    These remain where PYTHONPATH names them.
    """
    chosen = {os.path.abspath(path) for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path}
    started = {os.getcwd(), str(Path(sys.argv[0]).resolve().parent)} - chosen
    paths = dict.fromkeys(map(os.path.abspath, sys.path))
    return [path for path in paths if path not in started and os.path.exists(path)]


def _reported_error(content: bytes) -> ValueError | ProcessError:
    """The error that a process reports, whatever it sent."""
    try:
        report = json.loads(content)
        text = _printable(report["text"])
        return ValueError(text) if report["refused"] is True else ProcessError(text)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return ProcessError("its process reported an error that cannot be read")


def _printable(text: str) -> str:
    return "".join(letter if letter.isprintable() else " " for letter in " ".join(text.split()))


class RemoteController:
    """A controller whose agents are driven by processes.

    Parameters
    ----------
    processes
        Each has loaded the controller.
    scope
        What is sent.
    groups
        Agents that each process drives.
    """

    def __init__(self, processes: Sequence[ControllerProcess], scope: Scope, groups: Sequence[Sequence[str]]):
        self.observe, self._scope = scope.observe, scope
        self._processes, self._groups = processes, groups

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes."""
        layout, pickled = action_layout(env_info), pickle.dumps(env_info)
        self._n_action = layout.n
        n_observed = sum(map(len, field_names(env_info).values()))
        self._parts = []
        for process, group in zip(self._processes, self._groups, strict=True):
            driven = np.array([i for i, (agent, _) in enumerate(layout.names) if agent in group], np.int64)
            part = Part(self._scope.columns(env_info, group), n_observed, driven)
            process.ask(RESET, pickle.dumps((pickled, part)))
            self._parts.append((process, part))

    def measure(self, regulators: RegulatorState) -> None:
        """Send the measurements of the regulators to all processes, if the scope has them."""
        if self._scope.sends_regulators and regulators.tap.size:
            for process in self._processes:
                process.ask(MEASURE, np.stack(regulators).astype(np.float64).tobytes())

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Return the joint action for joint observations, (n_env, n_action)."""
        action = np.empty((len(observations), self._n_action))
        for process, part in self._parts:
            seen = np.ascontiguousarray(observations[:, part.seen], np.float32)
            answer = process.ask(ACT, seen.tobytes(), 8 * len(seen) * len(part.driven))
            action[:, part.driven] = np.frombuffer(answer).reshape(len(seen), len(part.driven))
        return action


class PlacedRemoteController(RemoteController):
    """A remote controller that is sent the agents' buses."""

    def place(self, buses: np.ndarray) -> None:
        """Send the buses to all processes."""
        for process in self._processes:
            process.ask(PLACE, np.ascontiguousarray(buses, np.int64).tobytes())


@contextmanager
def remote(
    spec: str, scenario: Scenario, tuned: Path, scope: Scope, code: bytes | None = None, confined: bool = True
) -> Iterator[Controller]:
    """Run a controller in separate processes for the block.

    Code of a submitter has a process for each agent, or one for all agents under a joint scope. For bundled
    controllers and weights, the package's own code runs in one process.

    Parameters
    ----------
    spec
        What names the controller, see ``find_controller``; of code ``controller.py:Class``.
    scenario
        The preset.
    tuned
        File of tuned parameters.
    scope
        What is sent.
    code
        Content of the submitter's file.
    confined
        Whether that code is confined.

    Raises
    ------
    ControllerError
        Where the controller cannot be made.
    """
    kind = PlacedRemoteController if scope.sends_model else RemoteController
    with ExitStack() as stack:
        if code is None:
            processes, groups = [_of_package()], [scenario.agents]
        else:
            groups = scope.groups(scenario)
            processes = [stack.enter_context(closing(ControllerProcess(of_submitter=True))) for _ in groups]
        for process in processes:
            try:
                process.load(spec, scenario, tuned, code, confined)
            except ProcessError as error:
                raise ControllerError(spec, "loading", error) from error
        yield kind(processes, scope, groups)


def _of_package() -> ControllerProcess:
    """The process that runs the package's own code, one after the other."""
    if not _shared or not _shared[-1].runs:
        _shared.append(ControllerProcess())
        atexit.register(_shared[-1].close)
    return _shared[-1]


_shared: list[ControllerProcess] = []
