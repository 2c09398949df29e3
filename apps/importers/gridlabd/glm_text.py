"""Text of GridLAB-D's .glm files as objects with properties.

Nothing is executed. Directives and blocks that only affect a simulation are skipped. Directives that start programs,
load code or read other kinds of files are refused with file and line. So are blocks that nest too deep and variables
that grow too long.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from dcgrid_env.apps.importers.opendss.script_files import file_beneath, text_of
from dcgrid_env.apps.importers.opendss.script_reader import DEEPEST, MOST_FILES
from dcgrid_env.grid.topology import FeederError

_TOKEN = re.compile(r'"[^"]*"|\'[^\']*\'|[{};]|[^\s{};"\']+|["\']')
_COMMENT = re.compile(r'"[^"]*"|\'[^\']*\'|//.*|/\*(?:.*?\*/|.*(?P<open>))')
_VARIABLE = re.compile(r"\$\{(\w+)\}")
_SKIPPED_DIRECTIVES = ("print", "verbose", "debug", "warning", "undef")
_SKIPPED_BLOCKS = ("clock", "schedule", "filter")
_SKIPPED_STATEMENTS = ("module", "global", "class")
_CODE = ("intrinsic", "function", "private", "public", "protected", "static", "include", "void")
_CONDITION = re.compile(r"(?P<name>[\w.:${}]+)\s*(?P<sign>==|!=|=)(?P<value>.*)")
_DEEPEST_BLOCK = 64
"""Blocks within blocks, and conditions within conditions; models nest three deep."""
_LONGEST_VALUE = 1024
"""Characters of a variable; GridLAB-D's have as many."""
_MOST_ADDED = 2**16
"""Characters by which variables may lengthen a line."""


@dataclass(frozen=True)
class Text:
    """Value of a property, and where it is."""

    text: str
    where: str


@dataclass(eq=False)
class GlmObject:
    """Object of a .glm file.

    Attributes
    ----------
    kind
        Its class, such as ``"overhead_line"``, without a module.
    number
        Number after the class, or ``""``.
    where
        File and line.
    parent
        The object that encloses it.
    properties
        Values by name; the last one where a property is set twice.
    """

    kind: str
    number: str
    where: str
    parent: GlmObject | None = None
    properties: dict[str, Text] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Its name, or ``class:number`` without one."""
        return self.properties["name"].text if "name" in self.properties else f"{self.kind}:{self.number}"


@dataclass
class GlmFile:
    """A .glm file and the files that it includes.

    Attributes
    ----------
    path
        The file.
    root
        Folder below which it may include files; its own by default.
    objects
        All objects in order.
    modules
        Settings of each module block, by module and name.
    schedules
        Names of the schedules.
    skipped
        Directives and blocks that were skipped, each with its file and line.
    files
        Files that were read, the model file first.
    """

    path: Path
    root: Path | None = None
    objects: list[GlmObject] = field(default_factory=list)
    modules: dict[str, dict[str, Text]] = field(default_factory=dict)
    schedules: set[str] = field(default_factory=set)
    skipped: list[tuple[str, str]] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)
    _variables: dict[str, str] = field(default_factory=dict)
    _unnamed: int = 0

    def __post_init__(self) -> None:
        if not self.path.is_file():
            raise FeederError(f"there is no file {self.path}; give a GridLAB-D model (.glm)")
        path, root = self.path.resolve(), (self.root or self.path.parent).resolve()
        if not path.is_relative_to(root):
            raise FeederError(f"{self.path} is not beneath the root folder {root}; give one that has it")
        self._root = root
        _Blocks(self, self._tokens(path, 0)).read()

    def new_object(self, header: str, where: str, parent: GlmObject | None) -> GlmObject:
        """Add an object with the header ``class:number``."""
        kind, _, number = header.partition(":")
        if ".." in number:
            raise FeederError(f"{where}: object {header}: several objects in one block; write one block for each")
        self._unnamed += 1
        item = GlmObject(kind.rpartition(".")[2], number or f"unnamed-{self._unnamed}", where, parent)
        self.objects.append(item)
        return item

    def _tokens(self, path: Path, depth: int) -> Iterator[tuple[str, str]]:
        """Tokens of a file and its includes, each with file and line."""
        self.files.append(path)
        if depth > DEEPEST or len(self.files) > MOST_FILES:
            raise FeederError(f"{path}: files include deeper than {DEEPEST} or more than {MOST_FILES} files")
        commented, branches = False, []
        for k, raw in enumerate(text_of(path).splitlines(), start=1):
            line, where = raw, f"{path}, line {k}"
            if not commented and line.lstrip().startswith("#"):
                words = _uncommented(line.strip().lstrip("#").strip(), r"\s//.*$")
                name, _, rest = words.partition(" ") if " " in words else words.partition("\t")
                yield from self._directive(name.lower().rstrip(";"), rest.strip(), where, path, depth, branches)
                continue
            line, commented = _without_comments(line, commented)
            if all(branches):
                line = self._expanded(line, where)
                for token in _TOKEN.findall(line):
                    yield token, where
        if branches:
            raise FeederError(f"{path}: #if without #endif")

    def _directive(
        self, name: str, rest: str, where: str, path: Path, depth: int, branches: list[bool]
    ) -> Iterator[tuple[str, str]]:
        rest = self._expanded(rest, where)
        if name in ("ifdef", "ifndef", "if"):
            check_depth(len(branches) + 1, where)
            branches.append(self._holds(name, rest, where))
        elif name in ("else", "endif"):
            if not branches:
                raise FeederError(f"{where}: #{name} without #if")
            last = branches.pop()
            branches += [not last] if name == "else" else []
        elif not all(branches):
            return
        elif name in ("define", "set"):
            variable, _, value = rest.rstrip(";").partition("=")
            if len(value) > _LONGEST_VALUE:
                raise FeederError(
                    f"{where}: #{name} {variable.strip()[:60]} has {len(value)} characters; give at most "
                    f"{_LONGEST_VALUE}"
                )
            self._variables[variable.strip()] = value.strip().strip("\"'")
            self.skipped.append((f"#{name} {variable.strip()}", where))
        elif name == "include":
            yield from self._tokens(self._included(rest, where, path), depth + 1)
        elif name in _SKIPPED_DIRECTIVES:
            self.skipped.append((f"#{name}", where))
        elif name == "error":
            raise FeederError(f"{where}: the file ends with #error {rest}")
        else:
            raise FeederError(
                f"{where}: #{name} is refused: it may start a program or read files; remove the line, or replace it "
                "by #include"
            )

    def _expanded(self, text: str, where: str) -> str:
        """A text with the values of variables in place of ``${NAME}``."""
        room = _MOST_ADDED

        def value(match: re.Match[str]) -> str:
            nonlocal room
            text = self._variables.get(match[1], match[0])
            room -= len(text)
            if room < 0:
                raise FeederError(f"{where}: variables make the line longer by more than {_MOST_ADDED}; shorten it")
            return text

        return _VARIABLE.sub(value, text)

    def _holds(self, name: str, rest: str, where: str) -> bool:
        if name != "if":
            return (rest in self._variables) == (name == "ifdef")
        condition = _CONDITION.fullmatch(rest.strip().removeprefix("(").removesuffix(")").strip())
        if condition is None:
            raise FeederError(f"{where}: #if {rest} cannot be read; write #if NAME==VALUE")
        value = self._variables.get(condition["name"], condition["name"])
        return (value == condition["value"].strip().strip("\"'")) == (condition["sign"] != "!=")

    def _included(self, rest: str, where: str, path: Path) -> Path:
        name = rest.rstrip(";").strip()
        if name[:1] not in ("\"'") or len(name) < 2:
            raise FeederError(f'{where}: #include {name} is refused: only #include "FILE" beneath {self._root} is read')
        try:
            return file_beneath(self._root, path.parent, name.strip("\"'"))
        except ValueError as error:
            raise FeederError(f"{where}: #include is refused: {error}") from None


def _uncommented(text: str, comment: str) -> str:
    return re.sub(comment, "", text).strip()


def _without_comments(line: str, commented: bool) -> tuple[str, bool]:
    """Return a line without comments, and whether a comment continues on the next line."""
    if commented:
        _, end, line = line.partition("*/")
        if not end:
            return "", True

    def kept(match: re.Match[str]) -> str:
        nonlocal commented
        commented = match["open"] is not None
        return match[0] if match[0][0] in "\"'" else " "

    commented = False
    return _COMMENT.sub(kept, line), commented


def check_depth(depth: int, where: str) -> None:
    """FeederError for blocks or conditions that nest too deep."""
    if depth > _DEEPEST_BLOCK:
        raise FeederError(f"{where}: blocks nest deeper than {_DEEPEST_BLOCK}; write objects one after the other")


class _Blocks:
    """Reader of blocks and statements from tokens."""

    def __init__(self, file: GlmFile, tokens: Iterator[tuple[str, str]]) -> None:
        self._file, self._tokens = file, tokens

    def read(self) -> None:
        """Read all blocks at the top of the file."""
        for words, end, where in self._statements(None):
            if end == "{":
                self._block(words, where)
            elif words and words[0] not in _SKIPPED_STATEMENTS:
                raise FeederError(f"{where}: {' '.join(words)[:60]!r} is refused: only objects and modules are read")
            elif words:
                self._file.skipped.append((" ".join(words), where))

    def _statements(self, opened: str | None) -> Iterator[tuple[list[str], str, str]]:
        """Words up to each ``;`` or ``{``, until the ``}`` that ends the block ``opened``."""
        words: list[str] = []
        first = ""
        for token, where in self._tokens:
            if token in (";", "{"):
                yield words, token, first or where
                words, first = [], ""
            elif token == "}":
                if words or opened is None:
                    raise FeederError(f"{where}: {' '.join(words)!r} before }} lacks a semicolon")
                return
            elif token in ('"', "'"):
                raise FeederError(f"{where}: a quotation mark without its counterpart")
            else:
                words.append(token)
                first = first or where
        if opened is not None or words:
            raise FeederError(f"{opened or first}: the block or statement does not end; add }} or ;")

    def _block(self, words: list[str], where: str) -> None:
        kind = words[0] if words else ""
        if kind == "object":
            self._object(words[1:], where, None)
        elif kind == "module":
            settings = self._file.modules.setdefault(" ".join(words[1:]), {})
            for setting, end, place in self._statements(where):
                if end == "{":
                    raise FeederError(f"{place}: a block within module {words[-1]} cannot be read")
                if setting:
                    settings[setting[0]] = _value(setting, place)
            self._file.skipped.append((" ".join(words), where))
        elif kind == "class":
            self._class(words, where)
        elif kind in _SKIPPED_BLOCKS:
            if kind == "schedule":
                self._file.schedules.add(" ".join(words[1:]))
            self._skip(where, 1)
            self._file.skipped.append((" ".join(words), where))
        else:
            raise FeederError(f"{where}: {' '.join(words)[:60]!r} is refused: only objects and modules are read")

    def _class(self, words: list[str], where: str) -> None:
        """Skip a class that declares properties; one with code is refused."""
        for declared, end, place in self._statements(where):
            if end == "{" or set(declared) & set(_CODE):
                raise FeederError(f"{place}: {' '.join(words)} has code, which is refused; remove the class")
        self._file.skipped.append((" ".join(words), where))

    def _skip(self, where: str, depth: int) -> None:
        check_depth(depth, where)
        for _, end, place in self._statements(where):
            if end == "{":
                self._skip(place, depth + 1)

    def _object(self, header: list[str], where: str, parent: GlmObject | None, depth: int = 1) -> GlmObject:
        check_depth(depth, where)
        if not header:
            raise FeederError(f"{where}: object without a class")
        item = self._file.new_object("".join(header), where, parent)
        for words, end, place in self._statements(where):
            if end == "{":
                position = words.index("object") if "object" in words else -1
                if position < 0 or position > 1:
                    raise FeederError(f"{place}: {' '.join(words)[:60]!r} before {{ cannot be read; expected object")
                inner = self._object(words[position + 1 :], place, None if position else item, depth + 1)
                if position:
                    item.properties[words[0]] = Text(inner.name, place)
            elif words:
                item.properties[words[0]] = _value(words, place)
        return item


def _value(words: list[str], where: str) -> Text:
    return Text(" ".join(word.strip("\"'") for word in words[1:]), where)
