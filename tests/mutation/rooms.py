"""Which modules a mutation run covers, and which tests are asked about each."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

from operators import Mutant, mutants_of

TOO_SLOW = "against_opendss"


@dataclass(frozen=True)
class Room:
    """Modules with the tests that should notice a mutant of them; paths from the root of the tree."""

    name: str
    modules: tuple[str, ...]
    tests: tuple[str, ...]
    near: dict[str, tuple[str, ...]]
    """More tests for the modules of a folder, or for one module."""
    private_cache: bool

    def asked(self, root: Path, module: str) -> list[str]:
        """Return the test files in the order in which they run for a module.

        First the module's own file, then those next to it, those listed for the module or its folder, and the room's.
        Files whose tests need another program's simulation are too slow for a trial, unless a list names them.
        """
        path = Path(module)
        folder = Path("tests") / path.parent
        beside = sorted(file for file in (root / folder).glob("test_*.py") if not file.stem.endswith(TOO_SLOW))
        listed = (*self.near.get(module, ()), *self.near.get(str(path.parent), ()), *self.tests)
        found: dict[str, None] = {}
        for file in (root / folder / f"test_{path.stem}.py", *beside, *(root / test for test in listed)):
            if file.is_dir():
                found |= {str(test.relative_to(root)): None for test in sorted(file.rglob("test_*.py"))}
            elif file.is_file():
                found[str(file.relative_to(root))] = None
        return list(found)

    def all_asked(self, root: Path) -> list[str]:
        """Return every test file that runs for some module of the room."""
        return list(dict.fromkeys(test for module in self.modules for test in self.asked(root, module)))


def read_rooms(file: Path, root: Path, names: list[str]) -> list[Room]:
    """The rooms named, or all of them; ValueError for one that is not there or has no module or test."""
    known = tomllib.loads(file.read_text())["rooms"]
    unknown = sorted(set(names) - set(known))
    if unknown:
        raise ValueError(f"no room {unknown[0]!r} in {file.name}; choose from {', '.join(known)}")
    found = []
    for name in names or known:
        given = known[name]
        modules = tuple(
            str(path.relative_to(root)) for pattern in given["modules"] for path in sorted(root.glob(pattern))
        )
        near = {place: tuple(tests) for place, tests in given.get("near", {}).items()}
        listed = [*near, *given["tests"], *(test for tests in near.values() for test in tests)]
        missing = [path for path in listed if not (root / path).exists()]
        if not modules or missing:
            what = missing[0] if missing else ", ".join(given["modules"])
            raise ValueError(f"room {name!r} of {file.name}: there is no {what}")
        found.append(Room(name, modules, tuple(given["tests"]), near, given.get("private_cache", False)))
    return found


def preloaded(file: Path) -> list[str]:
    """Modules that are imported once for all trials."""
    return tomllib.loads(file.read_text()).get("preload", [])


@dataclass(frozen=True)
class Equivalent:
    """A change that no test can notice, as nothing that the module promises changes with it."""

    module: str
    before: str
    after: str
    reason: str

    def is_of(self, mutant: Mutant) -> bool:
        """Whether a mutant is this change."""
        return (self.module, self.before, self.after) == (mutant.module, mutant.before, mutant.after)


def read_equivalents(file: Path) -> list[Equivalent]:
    """The changes listed in a file; ValueError for one without a reason."""
    found = [Equivalent(**entry) for entry in tomllib.loads(file.read_text()).get("equivalent", [])]
    for entry in found:
        if not entry.reason.strip():
            raise ValueError(f"{file.name}: {entry.module}: {entry.after!r} stands there without a reason; give one")
    return found


def all_mutants(root: Path, room: Room) -> list[Mutant]:
    """Every mutant of a room's modules."""
    return [mutant for module in room.modules for mutant in mutants_of(module, (root / module).read_bytes())]


def stale(root: Path, entries: list[Equivalent]) -> list[Equivalent]:
    """Return the entries that do not name a mutant of the current tree."""
    found: dict[str, list[Mutant]] = {}
    for module in {entry.module for entry in entries}:
        path = root / module
        found[module] = mutants_of(module, path.read_bytes()) if path.is_file() else []
    return [entry for entry in entries if not any(entry.is_of(mutant) for mutant in found[entry.module])]
