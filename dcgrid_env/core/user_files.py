"""Files of users and texts in their formats: regular files alone, of a bounded size, with values nested to a bound.

Every file that a user names is opened here. ``kind`` is the class of the errors; their message is one line with the
file's name. An OSError, as for a file that is missing or a folder, is that of the operating system.
"""

from __future__ import annotations

import errno
import io
import json
import os
import stat
import tomllib
from pathlib import Path
from typing import Any

from dcgrid_env.core.checked import DEEPEST, is_deep

MOST_MIB = 512
"""Largest file that is read into memory."""
MOST_TOML_MIB = 16
_KINDS = {stat.S_IFIFO: "a pipe", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device", stat.S_IFSOCK: "a socket"}
_OPENING = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)


def require_regular(path: Path, kind: type[ValueError]) -> os.stat_result:
    """Return the status of a regular file, or of one that a link leads to.

    Raises ``kind`` for a pipe, a device or a socket, and OSError if there is no file or the path is a folder.
    """
    try:
        status = path.stat()
    except ValueError as error:  # a null character
        raise kind(f"{str(path)!r} is not a path ({error}); give the path of a file") from None
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(status.st_mode):
        what = _KINDS.get(stat.S_IFMT(status.st_mode), "not a file")
        raise kind(f"{path} is {what}; write its content to a file and give the path of that file")
    return status


def is_file(path: Path, kind: type[ValueError]) -> bool:
    """Return whether there is a regular file; raise ``kind`` for a pipe, a device or a socket."""
    try:
        require_regular(path, kind)
    except OSError:
        return False
    return True


def open_bytes(path: Path, kind: type[ValueError]) -> io.FileIO:
    """Open a regular file for reading, without a buffer; errors are those of ``require_regular``."""
    require_regular(path, kind)
    return io.FileIO(path, "rb", opener=lambda name, flags: os.open(name, flags | _OPENING))


def read_bytes(path: Path, kind: type[ValueError], most_mib: int = MOST_MIB) -> bytes:
    """Read a regular file of at most ``most_mib`` MiB; raise ``kind`` for another one, before memory is taken."""
    largest = most_mib * 2**20
    with io.BufferedReader(open_bytes(path, kind)) as file:
        too_large = os.fstat(file.fileno()).st_size > largest
        content = b"" if too_large else file.read(largest + 1)
    if too_large or len(content) > largest:  # files of the system, as in /proc, are larger than their status says
        raise kind(f"{path} has more than {most_mib} MiB; give a smaller file")
    return content


def read_text(path: Path, kind: type[ValueError], most_mib: int = MOST_MIB) -> str:
    """Read a text file, UTF-8 with or without a mark, with line ends of any system as newlines.

    Raises ``kind`` for other bytes, and as ``read_bytes``.
    """
    content = read_bytes(path, kind, most_mib)
    try:
        return io.IncrementalNewlineDecoder(None, translate=True).decode(content.decode("utf-8-sig"), final=True)
    except UnicodeDecodeError as error:
        raise kind(f"{path}: {error}; save it as UTF-8") from None


def read_json(path: Path, kind: type[ValueError], remedy: str, most_mib: int = MOST_MIB) -> Any:
    """Read a JSON file; raise ``kind`` for a file that ``read_text`` or ``parse_json`` refuses."""
    return parse_json(read_text(path, kind, most_mib), str(path), kind, remedy)


def read_toml(path: Path, kind: type[ValueError]) -> dict[str, Any]:
    """Read a TOML file; raise ``kind`` for a file that ``read_text`` or ``parse_toml`` refuses."""
    return parse_toml(read_text(path, kind, MOST_TOML_MIB), str(path), kind)


def parse_json(text: str | bytes, where: str, kind: type[ValueError], remedy: str) -> Any:
    """Return the value of a JSON text.

    Raises ``kind`` for invalid JSON, a name that occurs twice in an object, and lists and objects more than ``DEEPEST``
    deep. The message begins with ``where`` and ends with the remedy.
    """
    try:
        value = json.loads(text, object_pairs_hook=_unique)
    except RecursionError:
        raise kind(f"{where}: {_TOO_DEEP}; {remedy}") from None
    except _TwiceError as error:
        raise kind(f"{where}: {error}") from None
    except ValueError as error:
        raise kind(f"{where}: is not JSON ({' '.join(str(error).split())[:200]}); {remedy}") from None
    _check_depth(value, where, kind, remedy)
    return value


def parse_toml(text: str, where: str, kind: type[ValueError]) -> dict[str, Any]:
    """Return the tables of a TOML text; raise ``kind`` for invalid TOML, and for values more than ``DEEPEST`` deep."""
    try:
        tables = tomllib.loads(text)
    except RecursionError:
        raise kind(f"{where}: {_TOO_DEEP}; {_FLATTER}") from None
    except ValueError as error:
        raise kind(f"{where}: {error}") from None
    _check_depth(tables, where, kind, _FLATTER)
    return tables


_TOO_DEEP = f"its values are nested more than {DEEPEST} deep"
_FLATTER = "write them without so many brackets or dots"


def _check_depth(value: object, where: str, kind: type[ValueError], remedy: str) -> None:
    if is_deep(value):
        raise kind(f"{where}: {_TOO_DEEP}; {remedy}")


class _TwiceError(ValueError):
    """Error of a name that occurs twice in an object."""


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    made = dict(pairs)
    if len(made) < len(pairs):
        seen: set[str] = set()
        twice = next(name for name, _ in pairs if name in seen or seen.add(name))
        raise _TwiceError(f"{twice!r} is there twice; leave one out")
    return made
