"""The process of a controller: it receives observations over a socket and returns actions.

``python -m dcgrid_env.agents.leaderboard.controller_process FD`` answers ``remote.ControllerProcess`` over the
socket FD. The process has neither seeds nor an environment. Each message is one byte that names it, the
length of its content in 8 bytes, and the content.
"""

from __future__ import annotations

import json
import os
import pickle
import socket
import struct
import sys
import time
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env import RegulatorState, Scenario, action_layout
from dcgrid_env.agents.leaderboard.confinement import confine
from dcgrid_env.agents.leaderboard.entry_files import CONTROLLER
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.baselines import NeedsRegulators, find_controller
from dcgrid_env.baselines.rollout import action_of
from dcgrid_env.baselines.user_code import described, one_line, place

LOAD, RESET, PLACE, MEASURE, ACT, DONE, FAILED = b"L", b"R", b"P", b"M", b"A", b"=", b"!"
HEADER = struct.Struct("<cQ")


class Part(NamedTuple):
    """What a process sees of the joint observation, and which of the joint action it gives."""

    seen: np.ndarray
    """Positions in the joint observation, (n_seen,)."""
    n_observed: int
    """Width of the joint observation; the rest is NaN."""
    driven: np.ndarray
    """Positions in the joint action, (n_driven,)."""


class Code(NamedTuple):
    """A submitter's file."""

    content: bytes
    confined: bool


class Loading(NamedTuple):
    """The controller of a process."""

    spec: str
    """What names the controller, see ``find_controller``."""
    scenario: bytes
    """Pickle of the preset."""
    tuned: Path
    """File of tuned parameters."""
    folder: Path
    """Working directory of the process, by which relative paths are found and where a submitter's file is to be."""
    code: Code | None = None
    """The submitter's file, where it is such."""


def send(channel: socket.socket, name: bytes, content: bytes = b"") -> None:
    """Send a message."""
    channel.sendall(HEADER.pack(name, len(content)) + content)


def receive(channel: socket.socket, most: int | None = None, limit_s: float | None = None) -> tuple[bytes, bytes]:
    """Receive a message.

    Parameters
    ----------
    channel
        The socket.
    most
        Largest length of a content that is accepted.
    limit_s
        Most time for all of it.

    Raises
    ------
    EOFError
        Where the other end is closed.
    TimeoutError
        Where the message is not here in time.
    ValueError
        Where its content is too long.
    """
    end_s = None if limit_s is None else time.monotonic() + limit_s
    name, length = HEADER.unpack(_exactly(channel, HEADER.size, end_s))
    if most is not None and length > most:
        raise ValueError(f"it sent {length} bytes")
    return name, _exactly(channel, length, end_s)


def _exactly(channel: socket.socket, n: int, end_s: float | None) -> bytes:
    parts = bytearray()
    while len(parts) < n:
        channel.settimeout(None if end_s is None else max(end_s - time.monotonic(), 1e-3))
        part = channel.recv(min(n - len(parts), 1 << 20))
        if not part:
            raise EOFError
        parts += part
    return bytes(parts)


class _Server:
    """Answers to messages."""

    def load(self, content: bytes) -> bytes:
        """Make the controller; a confined process is so before it sees the code."""
        loading: Loading = pickle.loads(content)
        os.chdir(loading.folder)
        if loading.code is not None:
            Path(CONTROLLER).write_bytes(loading.code.content)
            if loading.code.confined:
                confine(loading.folder)
        self._controller = find_controller(loading.spec, _scenario(loading.scenario), loading.tuned)
        return b""

    def reset(self, content: bytes) -> bytes:
        """Begin episodes of a scenario."""
        scenario, self._part = pickle.loads(content)
        self._scenario: Scenario = _scenario(scenario)
        self._n_action = action_layout(self._scenario).n
        self._controller.reset(self._scenario)
        return b""

    def place(self, content: bytes) -> bytes:
        """Give the buses."""
        self._controller.place(np.frombuffer(content, np.int64).reshape(-1, self._scenario.n_agents))  # pyright: ignore
        return b""

    def measure(self, content: bytes) -> bytes:
        """Give the measurements of the regulators."""
        if isinstance(self._controller, NeedsRegulators):
            feeder: Any = self._scenario.feeder
            shape = len(RegulatorState._fields), -1, len(feeder.network.regulator)
            self._controller.measure(RegulatorState(*np.frombuffer(content).reshape(shape)))
        return b""

    def act(self, content: bytes) -> bytes:
        """The action for an observation."""
        part: Part = self._part
        seen = np.frombuffer(content, np.float32).reshape(-1, len(part.seen))
        joint = np.full((len(seen), part.n_observed), np.nan, np.float32)
        joint[:, part.seen] = seen
        with np.errstate(invalid="ignore"):
            action = np.asarray(action_of(self._controller, joint), np.float64)
        if action.shape != (len(seen), self._n_action):
            raise ValueError(f"the action has shape {action.shape}; give {len(seen), self._n_action}")
        return action[:, part.driven].tobytes()


@lru_cache(maxsize=4)
def _scenario(pickled: bytes) -> Scenario:
    """One object for one scenario, with what was derived from it."""
    return pickle.loads(pickled)


def serve(channel: socket.socket) -> None:
    """Answer messages until the other end is closed."""
    server = _Server()
    answers: dict[bytes, Any] = {
        LOAD: server.load, RESET: server.reset, PLACE: server.place, MEASURE: server.measure, ACT: server.act,
    }  # fmt: skip
    while True:
        try:
            name, content = receive(channel)
        except EOFError:
            return
        try:
            with on_purpose():
                answer = answers[name](content)
        except BaseException as error:
            refused = name == RESET and isinstance(error, ValueError)
            text = one_line(error) if isinstance(error, ValueError) else described(error)
            send(channel, FAILED, json.dumps({"refused": refused, "text": text + place(error)}).encode())
        else:
            send(channel, DONE, answer)


if __name__ == "__main__":
    serve(socket.socket(fileno=int(sys.argv[1])))
