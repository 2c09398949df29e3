"""Units of power in the headers of files."""

import re

from dcgrid_env.traces.trace import TraceError

KW_PER_UNIT = {"W": 1e-3, "kW": 1.0, "MW": 1e3, "mW": 1e-6}
# Spellings that can only mean one unit; "mw" could mean two.
_SPELLINGS = {"w": "W", "watt": "W", "watts": "W", "kw": "kW"}


def require_unit(name: str, unit: str | None) -> None:
    """Raise TraceError, naming the file `name`, if `unit` is neither None nor known."""
    if unit is not None and unit not in KW_PER_UNIT:
        raise TraceError(f"{name}: unit {unit!r} is unknown; choose one of {', '.join(KW_PER_UNIT)}")


def bracketed(header: str) -> tuple[str, bool]:
    """What stands in brackets at the end of a column's name, and whether they are square; "" where nothing does."""
    found = re.search(r"\[([^\[\]]*)\]$|\(([^()]*)\)$", header.strip())
    if found is None:
        return "", False
    return (found[1] or found[2] or "").strip(), found[1] is not None


def column_unit(where: str, header: str, unit: str | None) -> str | None:
    """Unit of a column from its name and from what the caller gave; None if neither tells it.

    Square brackets hold a unit unless they hold a number (`gpu[0]`); round ones may hold anything.

    Parameters
    ----------
    where : text that begins a message, for example "file.csv, line 1".
    header : the column's name, for example `power.draw [W]`.
    unit : what the caller gave.

    Raises
    ------
    TraceError
        If the name holds another unit than the given one, or an unknown one and none is given.
    """
    inside, square = bracketed(header)
    named = inside if inside in KW_PER_UNIT else _SPELLINGS.get(inside.casefold())
    if named is None:
        if unit is None and square and not inside.isdigit():
            raise TraceError(
                f"{where}: {header!r} names the unit {inside!r}, which is none of {', '.join(KW_PER_UNIT)}; "
                "convert the column, or pass unit= if it is one of these all the same"
            )
        return unit
    if unit not in (None, named):
        raise TraceError(
            f"{where}: {header!r} names the unit {named}, but unit = {unit!r} is given; leave unit out, or rename "
            "the column if its name is wrong"
        )
    return named
