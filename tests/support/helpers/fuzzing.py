"""Files of feeders with one thing changed at random: a byte here and there, or one value, and what may come of it."""

import contextlib
import dataclasses
import random
import re
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env import FeederError

Files = dict[str, bytes]
SECONDS = 20
"""Longest that a file may take to read or refuse."""
ODD = ["nan", "inf", "-inf", "1e400", "-1", "0", "1e-320", "", "abc", "null", "true", "[]", "{}", '"7"',
       "99999999999999999999",        "1.5", "-0.0", "1e17", "0x10", "1,5", "1;2", "3 4"]  # fmt: skip
"""What a figure may become: words that programs write for none, and figures of the wrong kind or size."""
ODD_JSON = [None, True, "", "x", "\x1b[2J", [], {}, [1], {"x": 1}, [[]], -1, 1.5, 10**400, float("nan"), float("inf")]
"""What a value of a JSON file may become."""


@dataclass(frozen=True)
class Cell:
    """A figure in a file that defines the feeder: its position, and the words by which an error names it."""

    file: str
    span: tuple[int, int]
    names: tuple[str, ...] = ()


def mutated_bytes(files: Files, rng: random.Random) -> Files:
    """Files of which one has one to four bytes changed, or a piece left out, doubled or moved."""
    name = rng.choice(sorted(files))
    data = bytearray(files[name])
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(data) + 1)
        piece = bytes(data[at : at + rng.randint(1, 40)])
        match rng.randrange(6):
            case 0:
                data[at : at + 1] = bytes([rng.randrange(256)])
            case 1:
                data[at:at] = bytes([rng.choice(b"0123456789.,;:-+eE[]{}()\"'%#\n\t =_xNa")])
            case 2:
                del data[at : at + len(piece)]
            case 3:
                data[at:at] = piece
            case 4:
                del data[at:]
            case 5:
                data[at : at + 1] = rng.choice([b"\x00", b"\xff\xfe", b"\n", b"0", b"9", b"-"])
        if not data:
            break
    return files | {name: bytes(data)}


def mutated_value(files: Files, cell: Cell, rng: random.Random) -> tuple[Files, str, str]:
    """Files with one figure changed, what it was and what it is."""
    data = files[cell.file]
    was = data[slice(*cell.span)].decode()
    text = rng.choice(ODD)
    if rng.random() < 0.4:
        with contextlib.suppress(ValueError):
            text = repr(float(was) * rng.choice([1.1, 0.5, -1.0, 1e3, 1e-3]) + rng.choice([0.0, 0.01]))
    return files | {cell.file: data[: cell.span[0]] + text.encode() + data[cell.span[1] :]}, was, text


def outcome(read: Callable[[Path], Any], files: Files, folder: Path) -> Any:
    """What is read from files, or the FeederError; any other exception comes through, and so does one that takes
    long."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.iterdir():
        old.unlink()
    for name, data in files.items():
        (folder / name).write_bytes(data)
    try:
        with in_time():
            return read(folder)
    except FeederError as error:
        refused = error
    said = str(refused)
    assert said.strip(), "an error says something"
    assert len(said.splitlines()) == 1, said
    assert folder.name in said, f"the error names no file: {said}"
    return refused


@contextlib.contextmanager
def in_time():
    """TimeoutError where the block takes longer than ``SECONDS``."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def late(*_: object) -> None:
        raise TimeoutError(f"more than {SECONDS} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def same_number(was: str, text: str) -> bool:
    """Whether two texts are one number, so that a feeder need not change."""
    try:
        return float(was) == float(text)
    except ValueError:
        return was.strip() == text.strip()


def facts(feeder) -> dict[str, bytes | str]:
    """All that a feeder is, as plain values that compare."""
    values = {field.name: getattr(feeder, field.name) for field in dataclasses.fields(feeder)}
    found = {name: v.tobytes() if isinstance(v, np.ndarray) else repr(v) for name, v in values.items()}
    return found


def cells_of_csv(file: str, data: bytes, columns: set[str]) -> list[Cell]:
    """Cells with figures of some columns of a CSV file; an error names the file and the column."""
    lines = data.decode().split("\n")
    header, found, at = lines[0].split(","), [], len(lines[0]) + 1
    for line in lines[1:]:
        begin = at
        for column, text in zip(header, line.split(","), strict=False):
            if column in columns and re.fullmatch(r"-?[0-9.]+(e-?[0-9]+)?", text) and float(text) != 0:
                found.append(Cell(file, (begin, begin + len(text)), (column,)))
            begin += len(text) + 1
        at += len(line) + 1
    return found
