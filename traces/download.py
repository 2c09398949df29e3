"""Downloading a file whose checksum is known: it resumes, and only the right file ever stands under its name."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

from dcgrid_env.core.files import new_folder, sha256_of
from dcgrid_env.core.lock import alone
from dcgrid_env.traces.checks import TraceError

if TYPE_CHECKING:
    from pooch.typing import Downloader

Progress = Callable[[int, int], None]
"""Called with the bytes that are here and the bytes of the whole file."""

# What a broken connection costs at most; a larger piece is lost with it.
_CHUNK_BYTES = 1024
_TIMEOUT_S = 30.0


def download(url: str, sha256: str, size_bytes: int, path: Path, progress: Progress | None = None) -> Path:
    """Return `path` once it contains the file with this checksum; download the file only if it is missing.

    The downloaded part is kept in `path` + ".part" until the file is complete, and the next call resumes from it.
    Another process that needs the same file waits for it.

    Raises
    ------
    TraceError
        If the address cannot be reached or refuses, the connection breaks, the checksum differs, or the folder cannot
        be written.
    """
    if path.is_file() and sha256_of(path) == sha256:
        return path
    # Imported late: traces are used and imported without the means to download them.
    import pooch

    source = _Source(url, sha256, size_bytes, path, progress)
    try:
        with new_folder(path.parent), alone(path.with_name(path.name + ".lock")), _quiet(pooch.get_logger()):
            # The library's type for downloaders names other parameters than it passes.
            downloader = cast("Downloader", source)
            pooch.retrieve(url, f"sha256:{sha256}", fname=path.name, path=path.parent, downloader=downloader)
    except TraceError:
        raise
    except ValueError as error:  # the checksum is wrong, and what came is deleted by then
        raise TraceError(f"{url}: {error} Run the same command again, or {source.by_hand()}") from error
    except OSError as error:
        raise TraceError(
            f"{path.parent}: the file cannot be kept there ({error}); name another folder with DCGRID_CACHE"
        ) from error
    return path


@dataclass(frozen=True)
class _Source:
    """The downloader that pooch calls; pooch then checks what it left and puts it in place."""

    url: str
    sha256: str
    size_bytes: int
    path: Path
    progress: Progress | None

    @property
    def part(self) -> Path:
        return self.path.with_name(self.path.name + ".part")

    def __call__(self, url: str, output_file: str, pooch: object) -> None:
        self.complete()
        os.replace(self.part, output_file)

    def have(self) -> int:
        """Bytes that are here."""
        return self.part.stat().st_size if self.part.exists() else 0

    def complete(self) -> None:
        """Download the rest of the part; its content is not checked here."""
        import requests

        have = self.have()
        if have == self.size_bytes:
            return
        # Bytes as they are in the file: a range of a compressed answer could not be joined to what is here.
        headers = {"Accept-Encoding": "identity"} | ({"Range": f"bytes={have}-"} if have else {})
        answered = False
        try:
            with requests.get(self.url, headers=headers, stream=True, timeout=_TIMEOUT_S) as response:
                answered = True
                resumed = response.status_code == 206
                starts = response.headers.get("Content-Range", "").startswith(f"bytes {have}-")
                if response.status_code == 200 or (resumed and starts):
                    return self.append(response, have if resumed else 0)
                if not have or not (resumed or response.status_code == 416):
                    raise TraceError(f"{self.url} answers {response.status_code} {response.reason}; {self.by_hand()}")
        except requests.RequestException as error:
            if answered:
                raise TraceError(self.broken(_reason(error))) from error
            raise TraceError(
                f"{self.url} cannot be reached ({_reason(error)}); connect to the internet and run the same command "
                f"again, or {self.by_hand()}"
            ) from error
        # What is here does not go with the file there: from the beginning, and without a range.
        self.part.unlink()
        self.complete()

    def append(self, response, have: int) -> None:
        """Write the answer into the part from byte `have` on."""
        with self.part.open("ab" if have else "wb") as file:
            for chunk in response.iter_content(_CHUNK_BYTES):
                # No more than the whole: a longer file is a wrong one, and the checksum tells.
                have += file.write(chunk[: self.size_bytes - have])
                if self.progress is not None:
                    self.progress(have, self.size_bytes)
                if have == self.size_bytes:
                    return
        # An answer that told its length was held to it on the way; if too short all the same, it is a wrong file.
        if "Content-Length" not in response.headers and "Transfer-Encoding" not in response.headers:
            raise TraceError(self.broken("the server closed it"))

    def broken(self, reason: object) -> str:
        return (
            f"{self.url}: the connection broke off ({reason}); {self.have()} of {self.size_bytes} bytes are here, "
            "run the same command again to go on from there"
        )

    def by_hand(self) -> str:
        remedy = f"download the file by hand and put it at {self.path}, where it is checked and used"
        if self.path.is_file():
            remedy += f" (the one there now has SHA-256 {sha256_of(self.path)}, not {self.sha256})"
        return remedy


def _reason(error: Exception) -> object:
    """Return the message of the error that caused an error of requests."""
    inner = error.args[0] if error.args else error
    inner = getattr(inner, "reason", None) or inner
    return inner.args[0] if isinstance(inner, Exception) and inner.args else inner


@contextmanager
def _quiet(logger: logging.Logger) -> Iterator[None]:
    """Keep the library's notes off standard error meanwhile."""
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(level)
