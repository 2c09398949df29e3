"""Large text files in blocks of whole lines, with line numbers, gzip, UTF-8 or UTF-16, and the hash on the way."""

import csv
import gzip
import hashlib
import io
import os
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from dcgrid_env.core.user_files import open_bytes
from dcgrid_env.traces.checks import TraceError

BLOCK_CHARS = 1 << 22
LINE_LIMIT_CHARS = 1 << 20


class Block(NamedTuple):
    """Whole lines; only the last of a file may lack its line end."""

    first_line: int
    """Number of the first line, from 1."""
    text: str

    def lines(self, blank: str = " \t\n") -> Iterator[tuple[int, str]]:
        """Number and text of each line that holds more than characters of `blank`, without its line end."""
        for number, line in enumerate(self.text.split("\n"), self.first_line):
            if line.strip(blank):
                yield number, line

    def line_of(self, row: int, blank: str = " \t\n") -> int:
        """Number of the line of index `row` among `lines(blank)`."""
        return [number for number, _ in self.lines(blank)][row]


class TextFile:
    """An open text file, made by `open_text`; line ends of every system come as one newline."""

    def __init__(self, name: str, text: io.TextIOWrapper, hashed: "_Hashed", most_mib: int | None = None) -> None:
        self.name = name
        self._most_mib = most_mib
        self._n_read = 0
        self.line = 0
        """Number of the last line handed out."""
        self._text = text
        self._hashed = hashed

    def readline(self) -> str:
        """The next line with its line end, or an empty text at the end of the file."""
        line = self._line_rest()
        self.line += bool(line)
        self._count(line)
        return line

    def blocks(self) -> Iterator[Block]:
        """All further lines, some BLOCK_CHARS at a time."""
        while text := self._text.read(BLOCK_CHARS):
            if not text.endswith("\n"):
                text += self._line_rest()
            first = self.line + 1
            self.line += text.count("\n") + (not text.endswith("\n"))
            self._count(text)
            yield Block(first, text)

    def sha256(self) -> str:
        """SHA-256 of the file's bytes as they are stored, hexadecimal."""
        while self._hashed.read(1 << 20):
            pass
        return self._hashed.sha256.hexdigest()

    def _count(self, text: str) -> None:
        self._n_read += len(text)
        if self._most_mib is not None and self._n_read > self._most_mib * 2**20:
            raise TraceError(f"{self.name}: has more than {self._most_mib} MiB of text; give a shorter file")

    def _line_rest(self) -> str:
        line = self._text.readline(LINE_LIMIT_CHARS)
        if len(line) == LINE_LIMIT_CHARS and not line.endswith("\n"):
            raise TraceError(
                f"{self.name}, line {self.line + 1}: is longer than {LINE_LIMIT_CHARS} characters; "
                "give a text file of one sample on each line"
            )
        return line


class _Hashed(io.RawIOBase):
    """Passes bytes on and hashes them, so that the hash is of the bytes that were read, even if the file grows."""

    def __init__(self, raw: io.FileIO) -> None:
        self.sha256 = hashlib.sha256()
        self._raw = raw

    def readable(self) -> bool:
        return True

    def readinto(self, buffer, /) -> int:
        n = self._raw.readinto(buffer) or 0
        self.sha256.update(memoryview(buffer)[:n])
        return n


@contextmanager
def open_text(path: str | os.PathLike[str], most_mib: int | None = None) -> Iterator[TextFile]:
    """Open a text file: UTF-8, or UTF-16 with its mark (what redirection in PowerShell writes), gzip or plain.

    ``most_mib`` bounds the text, for readers that keep all of it in memory; a longer one raises TraceError.
    Errors in the bytes while the file is open raise TraceError, naming the file and the line.
    """
    path = Path(path)
    with open_bytes(path, TraceError) as raw, _Hashed(raw) as hashed, io.BufferedReader(hashed) as buffered:
        file = None
        try:
            source = gzip.GzipFile(fileobj=buffered) if buffered.peek(2)[:2] == b"\x1f\x8b" else buffered
            encoding = "utf-16" if source.peek(2)[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
            with source, io.TextIOWrapper(source, encoding) as text:
                file = TextFile(path.name, text, hashed, most_mib)
                yield file
        except (UnicodeDecodeError, csv.Error) as error:
            after = f"after line {file.line}: " if file else ""
            raise TraceError(
                f"{path.name}: is not a UTF-8 text file of cells ({after}{error}); export it as CSV"
            ) from error
        except (EOFError, gzip.BadGzipFile, zlib.error) as error:
            after = f" after line {file.line}" if file else ""
            raise TraceError(f"{path.name}: cannot be unpacked{after} ({error}); fetch or compress it again") from error


def stem(path: str | os.PathLike[str]) -> str:
    """The file's name without its folder, `.gz` and its last suffix."""
    return Path(Path(path).name.removesuffix(".gz")).stem
