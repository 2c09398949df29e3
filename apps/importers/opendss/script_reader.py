"""The commands of an OpenDSS script and of those that it redirects to, each read, checked and rewritten.

OpenDSS itself opens no script. It receives these lines one by one, so it runs exactly the lines that were checked.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from dcgrid_env.apps.importers.opendss import script_rules as rules
from dcgrid_env.apps.importers.opendss.dss_words import CLOSING, Word, quoted, words_of
from dcgrid_env.apps.importers.opendss.script_counts import Counts
from dcgrid_env.apps.importers.opendss.script_files import file_beneath, text_of
from dcgrid_env.grid.topology import FeederError

DEEPEST = 32
"""How deep scripts may redirect to further ones."""
MOST_FILES = 2000
"""Largest number of scripts to read; a script that is read twice counts twice."""


class Line(NamedTuple):
    """A command that is safe to run, and its position in the scripts."""

    command: str
    where: str


@dataclass
class Script:
    """A master script that is read as an iterator over its commands.

    Attributes
    ----------
    master
        The file.
    root
        Folder below which files may be read; the master file's by default.
    commands, options, classes
        Names that the OpenDSS at hand knows, by which abbreviations are resolved.
    counts
        The properties that are whole numbers.
    skipped
        Commands, options and properties that were left out so far, each with its file and line.
    files
        The files that were read or named so far, scripts and figures, in order.
    """

    master: Path
    commands: Sequence[str]
    options: Sequence[str]
    classes: Sequence[str]
    counts: Counts
    root: Path | None = None
    skipped: list[tuple[str, str]] = field(default_factory=list)
    files: dict[Path, None] = field(default_factory=dict)
    _root: Path = field(init=False)
    _kind: str | None = field(init=False, default=None)
    """Class of the element that ``~`` goes on with."""
    _read: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self._root = (self.root or self.master.parent).resolve()

    def lines(self) -> Iterator[Line]:
        """Give the commands in order.

        Raises
        ------
        FeederError
            Naming the file, the line, the command and what is wrong with it.
        """
        master = self.master.resolve()
        if not master.is_relative_to(self._root):
            raise FeederError(f"{self.master} is not beneath the root folder {self._root}; give one that has it")
        yield from self._file(master, 0)

    def _file(self, path: Path, depth: int) -> Iterator[Line]:
        self._read += 1
        if depth > DEEPEST or self._read > MOST_FILES:
            raise FeederError(f"{path}: scripts redirect deeper than {DEEPEST} or to more than {MOST_FILES} files")
        self.files[path] = None
        folder, commented = path.parent, False
        for number, text in enumerate(text_of(path).replace("\r\n", "\n").replace("\r", "\n").split("\n"), start=1):
            line = text.strip(" \t\0\x1a")  # ends of text that old editors leave
            if commented or line.startswith("/*"):
                commented = "*/" not in line
                continue
            if not line or line.startswith(("!", "//")):
                continue
            where = f"{path}, line {number}"
            if skipped := self._skipped_command(line):
                self.skipped.append((skipped, where))
                continue
            try:
                name, words = self._command(words_of(line))
                if name in ("redirect", "compile"):
                    script = self._file_beneath(folder, self._path(words))
                    yield from self._file(script, depth + 1)
                    folder = script.parent if name == "compile" else folder
                    continue
                checked = self._checked(name, words, folder, where)
                if checked or not words:
                    yield Line(" ".join([name, *map(str, checked)]), where)
            except FeederError:
                raise
            except ValueError as error:
                raise FeederError(
                    f"{where}: {line.split()[0][:60]!r} is refused: {error}; if you trust the file, --trust runs it "
                    "as it is"
                ) from None

    def _skipped_command(self, line: str) -> str:
        """The command of a line that is left out, or an empty text."""
        first = line.replace("\t", " ").split(" ")[0]
        try:
            name = rules.resolved(first, rules.SKIPPED, self.commands)
        except ValueError:
            return ""
        self._kind = None
        return name

    def _command(self, words: list[Word]) -> tuple[str, list[Word]]:
        """The command that a line gives, written out, and the words behind it."""
        first = words[0]
        if not first.name:
            name = rules.resolved(first.text, rules.COMMANDS, self.commands)
            return ("more" if name in ("m", "~") else name), words[1:]
        element, dot, one = first.name.rpartition(".")
        if not dot or "." not in element:
            raise ValueError(f"{first.name!r} is no command")
        return "edit", [quoted(element), first._replace(name=one), *words[1:]]

    def _file_beneath(self, folder: Path, name: str) -> Path:
        path = file_beneath(self._root, folder, name)
        self.files[path] = None
        return path

    def _path(self, words: list[Word]) -> str:
        if len(words) != 1 or words[0].name.lower() not in ("", "file"):
            raise ValueError("give one file, in quotes where its name has blanks")
        return words[0].text

    def _checked(self, name: str, words: list[Word], folder: Path, where: str) -> list[Word]:
        if name in rules.FILES:
            return [Word("", str(self._file_beneath(folder, self._path(words))), '"')]
        if name in rules.OPTIONS:
            self._kind = None
            kept = [word for word in words if not self._is_skipped_option(word, where)]
            return [rules.check_option(word, self.options) for word in kept]
        if name not in rules.DEFINING:
            self._kind = None
            rules.check_plain(name, words)
            return words
        element = []
        if name != "more":
            element, words = words[:1], words[1:]
            self._kind = self._class_of(element)
        elif self._kind is None:
            raise ValueError("it goes on with no New or Edit before it")
        kind = self._kind or ""
        for word in words:
            if word.name.lower() == "debugtrace":
                self.skipped.append(("debugtrace", where))
        words = [word for word in words if word.name.lower() != "debugtrace"]
        self.counts.check(kind, words)
        leading = next((k for k, word in enumerate(words) if word.name), len(words))
        first = [k < min(leading, rules.HARMLESS_POSITIONS) for k in range(len(words))]
        pairs = zip(words, first, strict=True)
        return [*element, *(self._property(kind, word, is_first, folder) for word, is_first in pairs)]

    def _is_skipped_option(self, word: Word, where: str) -> bool:
        try:
            name = rules.resolved(word.name, rules.SKIPPED_OPTIONS, self.options) if word.name else ""
        except ValueError:
            return False
        if name:
            self.skipped.append((f"set {name}", where))
        return bool(name)

    def _class_of(self, element: list[Word]) -> str:
        if not element or element[0].name.lower() not in ("", "object") or "." not in element[0].text:
            raise ValueError("give the element as class.name first")
        kind = element[0].text.partition(".")[0].lower()
        if kind not in {"circuit", *map(str.lower, self.classes)}:
            raise ValueError(f"{kind!r} is no class of elements that OpenDSS knows")
        return kind

    def _property(self, kind: str, word: Word, is_first: bool, folder: Path) -> Word:
        """A property with the file that it names, if any, by its whole path."""
        names = rules.check_property(kind, word, is_first)
        if names == "all":
            return Word(word.name, str(self._file_beneath(folder, word.text)), '"')
        match = rules.FILE_WITHIN.match(word.text) if names else None
        if match is None:
            return word
        path = self._file_beneath(folder, match["path"].strip("\"'"))
        if CLOSING[word.quote] in str(path) or word.quote in str(path):
            raise ValueError(f"{str(path)!r} holds {word.quote}; rename the folder or the file")
        columns = "".join(f",{key}={value}" for key, value in rules.COLUMNS_WITHIN.findall(match["rest"]))
        return word._replace(text=f'{match["kind"]}="{path}"{columns}')
