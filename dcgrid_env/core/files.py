"""Files that are written whole or not at all, so that an error or an interruption leaves nothing half done."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import io
import json
import os
import secrets
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

_PREFIX, _SUFFIX = ".dcgrid-", ".part"


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Make a folder and those above it; if the block fails, delete the created folders that are empty.

    OSError if it cannot be made.
    """
    missing = _missing(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield folder
    except BaseException:
        _remove_empty(missing)
        raise


def require_folder(folder: Path) -> None:
    """Raise OSError unless a folder exists or can be made; a folder made for the check is deleted."""
    missing = _missing(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    finally:
        _remove_empty(missing)


def _missing(folder: Path) -> list[Path]:
    """Return the missing ones among the folder and those above it, the innermost first."""
    return [one for one in (folder, *folder.parents) if not one.exists()]


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        with contextlib.suppress(OSError):  # not made, or not empty
            folder.rmdir()


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Let an OSError of the block that names no file name this one, as where no space is left on the device."""
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno is not None:
            error.filename = str(path)
        raise


def require_replaceable(path: Path) -> None:
    """Raise FileExistsError if there is a pipe, a device or a socket, or a link to one, which a file would replace."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise FileExistsError(f"{path} is a device or a pipe; give the path of a file")


def require_space(folder: Path, n_bytes: int, behind: int = 0) -> None:
    """Raise OSError unless that many bytes can be added to a file there that has ``behind`` already."""
    part = folder / f"{_PREFIX}{secrets.token_hex(8)}{_SUFFIX}"
    try:
        with part.open("xb") as file:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), behind, n_bytes)
            elif shutil.disk_usage(folder).free < n_bytes:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def whole(path: Path) -> Iterator[IO[bytes]]:
    """Open a file to be written: ``path`` is there, with all of it, once the block has ended without an error.

    It is written under a unique name in the same folder, so two simultaneous writers do not collide. Missing folders
    are made. OSError if it cannot be written.
    """
    require_replaceable(path)
    with naming(path), new_folder(path.parent):
        part = path.with_name(f"{_PREFIX}{secrets.token_hex(8)}{_SUFFIX}")
        try:
            with part.open("xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Fill a folder: ``folder`` is there, with all of it, once the block has ended without an error.

    The block writes to a sibling folder with another name; folders above are made.

    Raises
    ------
    OSError
        If it cannot be made, or exists and is not empty, also where another process has filled it meanwhile.
    """
    folder = folder.absolute()
    with new_folder(folder.parent):
        part = folder.with_name(f"{_PREFIX}{secrets.token_hex(8)}{_SUFFIX}")
        try:
            part.mkdir()
            yield part
            try:
                if folder.exists():
                    folder.rmdir()
                part.replace(folder)
            except OSError as error:
                if error.errno in (errno.ENOTEMPTY, errno.EEXIST):
                    raise FileExistsError(f"{folder} has been filled meanwhile; give another folder") from None
                raise
        finally:
            shutil.rmtree(part, ignore_errors=True)


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, as hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file whole or not at all; folders are made."""
    with whole(path) as file:
        file.write(content)


def write_text(path: Path, text: str) -> None:
    """Write text as UTF-8, whole or not at all; folders are made."""
    write_bytes(path, text.encode())


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON, whole or not at all; folders are made. ValueError for a NaN in it, before anything is written."""
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def write_figure(path: Path, figure: Any, dpi: float) -> None:
    """Write a figure of Matplotlib, whole or not at all, in the format that the file's suffix names (PNG without one).

    ValueError for a format that Matplotlib does not write, before anything is written.
    """
    drawn = io.BytesIO()
    figure.savefig(drawn, format=path.suffix[1:] or "png", dpi=dpi)
    write_bytes(path, drawn.getvalue())


def clear_parts(folder: Path) -> None:
    """Delete the temporary files of a killed process in a folder; no other process may write to it."""
    for part in folder.glob(f"{_PREFIX}*{_SUFFIX}"):
        part.unlink(missing_ok=True)
