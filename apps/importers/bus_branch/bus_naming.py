"""Names by which the buses of another program's grid are known in a feeder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from dcgrid_env.grid.topology import FeederError


def named_buses(source: str, names: Sequence[str]) -> tuple[str, ...]:
    """Names without spaces at their ends; FeederError where one is empty, has a line end or is there twice."""
    stripped = tuple(name.strip() for name in names)
    for row, name in enumerate(stripped):
        if not name or len(name.splitlines()) != 1:
            raise FeederError(f"{source}: the name of bus {row + 1} in the table is {name!r}; leave the bus names out")
    twice = [name for name, count in Counter(stripped).items() if count > 1]
    if twice:
        raise FeederError(f"{source}: {twice[0]!r} is the name of several buses; leave the bus names out")
    return stripped


@contextmanager
def errors_naming(source: object) -> Iterator[None]:
    """Put the source, such as a file's path, before each FeederError that does not name it; arithmetic that fails is
    one."""
    try:
        yield
    except FeederError as error:
        if str(source) in str(error):
            raise
        raise FeederError(f"{source}: {error}") from None
    except ArithmeticError as error:
        raise FeederError(f"{source}: a figure is too large or too small to reckon with ({error})") from None
