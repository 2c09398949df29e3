"""Registries of objects by name, with the entries of this package and of others, which declare entry points.

An entry point of a registry's group (``dcgrid.controllers``, ``dcgrid.scenarios``, ``dcgrid.feeders``,
``dcgrid.devices``) hands over a mapping: each name, with a pair of what it is, in a few words, and a function that
makes it; for a kind of device, its class. In another package's
pyproject.toml, and in its module ``laws``:

    [project.entry-points."dcgrid.controllers"]
    laws = "their_package.laws:CONTROLLERS"

    CONTROLLERS = {"their-law": ("proportional droop with a dead time", TheirLaw)}

Nothing is loaded before a name is asked for that this package does not have, or before all names are. This package's
own entry points come first, then those of others in the order of the alphabet; who comes first keeps a name. An entry
point that cannot be loaded, hands over something else or repeats a name is one warning, and the others go on.
"""

from __future__ import annotations

import importlib.metadata
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from importlib.metadata import Distribution, EntryPoint, EntryPoints, distributions, entry_points
from typing import Any

from dcgrid_env.core.suggestions import unknown

OWN_DISTRIBUTION = "dcgrid-env"
Entry = tuple[str, Callable[..., Any]]
"""Short description of an entry, and the function that makes it."""


class PluginWarning(UserWarning):
    """Warning that another package's entry point is skipped, completely or in part."""


class PluginError(ValueError):
    """Error of another package's entry point; the message is one line."""

    traced = True
    """Whether a traceback adds information to the message."""


class Registry(Mapping[str, Entry]):
    """Entries by name: those of this package, and those from entry points.

    Parameters
    ----------
    group
        The entry points' group.
    kind
        Word for the objects that the entries make, for messages.
    made
        Type of the objects that the entries make, or several types.
    bundled
        Entries of this package, which need no installed metadata.
    """

    def __init__(self, group: str, kind: str, made: type | tuple[type, ...], bundled: Mapping[str, Entry]):
        self.group, self.kind, self._bundled = group, kind, bundled
        self._made = made if isinstance(made, tuple) else (made,)
        self._entries: dict[str, Entry] = {}
        self._origins: dict[str, str] = {}
        self._refused: list[str] = []
        self._waiting: list[EntryPoint] | None = None
        self._is_installed = False

    def __getitem__(self, name: str) -> Entry:
        while name not in self._bundled and name not in self._entries:
            if not self._load_next():
                raise KeyError(name)
        return self._bundled[name] if name in self._bundled else self._entries[name]

    def __iter__(self) -> Iterator[str]:
        while self._load_next():
            pass
        return iter([*self._bundled, *self._entries])

    def __len__(self) -> int:
        return len(list(iter(self)))

    def make(self, name: str, *arguments: Any) -> Any:
        """Make the object with a name.

        Raises
        ------
        KeyError
            For an unknown name, see ``unknown``.
        PluginError
            If another package's function fails or makes another type; the message names the package.
        """
        _, make = self[name]
        if name not in self._origins:
            return make(*arguments)
        whose = f"{self.kind} {name!r} of {self._origins[name]}"
        try:
            made = make(*arguments)
        except (Exception, SystemExit) as error:
            raise PluginError(f"{whose} cannot be made: {_described(error)}; mend or uninstall it") from error
        if not isinstance(made, self._made):
            expected = " or ".join(kind.__name__ for kind in self._made)
            raise PluginError(f"{whose} is of type {type(made).__name__} and no {expected}; mend it")
        return made

    def origin(self, name: str) -> str | None:
        """Return the name and version of the other package that defines a name; None for this package's names."""
        return self._origins.get(name)

    def unknown(self, name: object) -> str:
        """Return the message for an unknown name: similar names, and entry points that failed to load."""
        listed = f"`dcgrid list {self.group.removeprefix('dcgrid.')}` lists all"
        said = [unknown(self.kind, name, filter(is_name, self), listed), *self._refused]
        if not self._is_installed:
            said.append(f"the installed metadata of {OWN_DISTRIBUTION} is older than its code: install it again")
        return "; ".join(said)

    def _load_next(self) -> bool:
        """Load the next entry point; False where there is none."""
        if self._waiting is None:
            self._waiting = sorted(_points(self.group), key=_place)
            self._is_installed = any(map(_is_own, self._waiting))
        if not self._waiting:
            return False
        point = self._waiting.pop(0)
        try:
            if not point.pattern.match(point.value):
                raise ValueError(f"{point.value!r} does not have the form module:object")
            handed_over = point.load()
            _check(handed_over)
        except (Exception, SystemExit) as error:
            self._refuse(point, f"is left out: {_described(error)}; mend or uninstall it")
            return True
        taken = []
        for name, entry in handed_over.items() if handed_over is not self._bundled else ():
            if (known := self._bundled.get(name) or self._entries.get(name)) is not None:
                if known[1] is not entry[1]:
                    taken.append(name)
                continue
            self._entries[name] = entry
            if not _is_own(point):
                self._origins[name] = _origin(point)
        if taken:
            self._refuse(point, f"repeats {', '.join(taken)}, which stays what it is; give it another name")
        return True

    def _refuse(self, point: EntryPoint, why: str) -> None:
        said = f"entry point {point.name!r} ({self.group}, {point.value}) of {_origin(point)} {why}"
        self._refused.append(said)
        warnings.warn_explicit(said, PluginWarning, filename=_origin(point), lineno=0)  # no line of ours is to blame


def is_name(entry: str) -> bool:
    """Return whether an entry is a full name, not a file ending or a prefix of another name."""
    return not (entry.startswith(".") or entry.endswith(":"))


def _check(handed_over: object) -> None:
    """Raise TypeError unless an entry point returns entries by name."""
    if not isinstance(handed_over, Mapping):
        raise TypeError(f"it is of type {type(handed_over).__name__}, not a mapping of names")
    for name, entry in handed_over.items():
        is_pair = isinstance(entry, tuple) and len(entry) == 2
        if not (isinstance(name, str) and is_pair and isinstance(entry[0], str) and callable(entry[1])):
            raise TypeError(f"{name!r} has no pair of what it is (a text) and what makes it (a function)")


def tolerate_malformed() -> None:
    """Leave out packages with a malformed file of entry points for all libraries of this process, with a warning.

    Such a file otherwise ends the import of libraries that look for their plug-ins, such as typeguard and numba.
    """
    try:
        entry_points(group="dcgrid.controllers")
    except Exception:
        importlib.metadata.entry_points = lambda **wanted: EntryPoints(_readable_points()).select(**wanted)


def _points(group: str) -> Iterable[EntryPoint]:
    try:
        return entry_points(group=group)
    except Exception:  # one malformed file of any package fails them all
        return [point for point in _readable_points() if point.group == group]


@cache
def _readable_points() -> list[EntryPoint]:
    """Return the entry points of all packages whose file of them can be read; one warning for each other package."""
    points: list[EntryPoint] = []
    seen: set[str] = set()
    for distribution in distributions():
        called = _called(distribution)
        try:
            found = list(distribution.entry_points)
        except Exception as error:
            said = f"the entry points of {called} cannot be read: {_described(error)}; mend or uninstall it"
            warnings.warn_explicit(said, PluginWarning, filename=called, lineno=0)
            continue
        if called.split()[0] not in seen:  # the first of a name hides later ones
            points += found
        seen.add(called.split()[0])
    return points


def _called(distribution: Distribution) -> str:
    """Return the name and version of a package, or where its metadata are if these cannot be read."""
    try:
        name, version = distribution.metadata["Name"], distribution.version
    except Exception:
        name = version = None
    return f"{name} {version}" if name and version else str(distribution.locate_file("an unknown package"))


def _is_own(point: EntryPoint) -> bool:
    return _origin(point).split()[0] == OWN_DISTRIBUTION


def _place(point: EntryPoint) -> tuple[bool, str, str]:
    return not _is_own(point), _origin(point), point.name


def _origin(point: EntryPoint) -> str:
    return "an unknown package" if point.dist is None else _called(point.dist)


def _described(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
