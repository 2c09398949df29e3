"""Report on an import: whether each element of another program's grid was taken, left out or refused."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

from dcgrid_env.grid.topology import FeederError

Fate = Literal["taken", "nothing lost", "lost", "refused"]
_SHOWN = 5
UNBALANCED = "its phases differ, and each gets their mean in a balanced feeder"
"""What becomes of a load or generator with a power for each phase."""


@dataclass(frozen=True)
class Finding:
    """Elements of one kind that fare alike.

    Attributes
    ----------
    kind
        Class of the elements in lower case, such as ``"line"`` or ``"capcontrol"``; ``"isolated"`` for what has no
        supply in OpenDSS.
    names
        Their names.
    fate
        Whether they are in the tables (``taken``), need not be (``nothing lost``), are left out with something that
        matters (``lost``, which must be allowed), or cannot be represented (``refused``).
    text
        What becomes of them, or what is wrong.
    """

    kind: str
    names: tuple[str, ...]
    fate: Fate
    text: str

    @property
    def shown(self) -> str:
        """The first names, and how many there are beyond."""
        return shown_names(self.names)


def shown_names(names: Sequence[str]) -> str:
    """The first of several names, and how many there are beyond."""
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


@dataclass
class Report:
    """Findings as they are made; those of one kind, fate and text become one."""

    subject: str = "circuit"
    """What the source calls a grid."""
    _names: dict[tuple[str, Fate, str], list[str]] = field(default_factory=dict)

    def add(self, fate: Fate, kind: str, name: str, text: str) -> None:
        """Note what becomes of an element."""
        self._names.setdefault((kind, fate, text), []).append(name)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All that was noted, what matters most last."""
        order: tuple[Fate, ...] = ("taken", "nothing lost", "lost", "refused")
        rows = [Finding(kind, tuple(names), fate, text) for (kind, fate, text), names in self._names.items() if names]
        return tuple(sorted(rows, key=lambda row: order.index(row.fate)))

    def add_all(self, fate: Fate, kind: str, names: Iterable[str], text: str) -> None:
        """Note what becomes of several elements; none leave no trace."""
        names = list(names)
        if names:
            self._names.setdefault((kind, fate, text), []).extend(names)

    def withdraw(self, kind: str, names: Iterable[str]) -> None:
        """Forget that elements were taken, because they turn out to be left out."""
        for (row_kind, fate, _), noted in self._names.items():
            if (row_kind, fate) == (kind, "taken"):
                noted[:] = [name for name in noted if name not in names]

    def refuse_unless(self, name: str, allow: Iterable[str]) -> None:
        """FeederError where something cannot be represented, or is lost and not of an allowed kind."""
        allowed = {kind.lower() for kind in allow}
        refused = [row for row in self.findings if row.fate == "refused"]
        lost = [row for row in self.findings if row.fate == "lost" and row.kind not in allowed]
        texts = [f"{row.kind} {row.shown}: {row.text}" for row in refused or lost]
        if refused:
            raise FeederError(f"{self.subject} {name!r} cannot be represented: {'; '.join(texts)}")
        if lost:
            kinds = ",".join(dict.fromkeys([*sorted(allowed), *(row.kind for row in lost)]))
            raise FeederError(
                f"{self.subject} {name!r} has what would be lost: {'; '.join(texts)}; --allow {kinds} accepts that"
            )
