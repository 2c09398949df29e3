"""Remedies in messages of errors: names similar to one that does not exist, and how to install an extra."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher

_SIMILAR = 0.6
"""Least similarity of a suggestion, of 1 for the same name; difflib's own."""


def unknown(kind: str, name: object, names: Iterable[str], listed: str) -> str:
    """Return the message for a name that does not exist.

    Parameters
    ----------
    kind
        What is named, for instance "scenario".
    name, names, listed
        Passed on to ``nearest``.
    """
    return f"no {kind} {name!r}; {nearest(name, names, listed)}"


def nearest(name: object, names: Iterable[str], listed: str) -> str:
    """Return up to three names that are similar to one that does not exist, and where all names are listed.

    Parameters
    ----------
    name
        The name that does not exist.
    names
        The names that exist. Only the last word of a name is compared, so ``dcgrid traces show`` is similar to "show".
    listed
        Where all names are listed, a clause: "`dcgrid list scenarios` lists all".
    """
    given = str(name).lower()
    similarity = {known: SequenceMatcher(None, known.rpartition(" ")[2].lower(), given).ratio() for known in names}
    near = sorted((known for known in similarity if similarity[known] >= _SIMILAR), key=lambda n: -similarity[n])[:3]
    return f"did you mean {' or '.join(filter(None, (', '.join(near[:-1]), near[-1])))}? {listed}" if near else listed


def from_clone(extra: str) -> str:
    """Return the command that installs an extra of pyproject.toml in a clone: the package is not on a registry."""
    return f"in a clone of the repository: pip install -e '.[{extra}]'"
