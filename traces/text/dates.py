"""Times of a reading as files write them: a date and time, or a number since 1970."""

from datetime import UTC, datetime

from dcgrid_env.traces.checks import TraceError
from dcgrid_env.traces.text.times import PARTS, epoch_unit

FORMS = "2026-01-02T03:04:05.678Z, 02.01.2026 03:04:05 or 1767323045.678 (s since 1970)"
_DAY_FIRST = ("%d.%m.%Y %H:%M", "%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S.%f")


def date_of(text: str) -> datetime:
    """Return a date and time of the forms ISO 8601 and DD.MM.YYYY HH:MM; raise ValueError for another text.

    A date and a time may be separated by `T`, a space or `_`, and the parts of a date by `-` or `/`.
    """
    text = text.strip()
    if "." in text[:3]:
        for form in _DAY_FIRST:
            try:
                return datetime.strptime(text, form)
            except ValueError:
                continue
    if text.replace(".", "", 1).isdigit():
        raise ValueError(text)
    return datetime.fromisoformat(text.replace("_", "T").replace("/", "-"))


def seconds(text: str | float, where: str) -> float:
    """Time since 1970, s, of a number or a date and time; without an offset it counts as UTC.

    A number that is a time in ms, us or ns since 1970 counts as such. Raises TraceError, with `where` at its beginning,
    for another text.
    """
    try:
        time = float(text)
    except (TypeError, ValueError):
        try:
            date = date_of(str(text))
        except ValueError:
            raise TraceError(f"{where}: the time is {str(text)[:40]!r}; write it like {FORMS}") from None
        return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()
    return time / PARTS[epoch_unit(time) or "s"]


def utc_offset_h(text: str) -> float | None:
    """Return the UTC offset of a date and time, h; None for a time without one."""
    try:
        offset = date_of(text).utcoffset()
    except ValueError:
        return None
    return None if offset is None else offset.total_seconds() / 3600.0


def is_date(text: str) -> bool:
    """Return whether a text is a date and time, and not a number."""
    try:
        date_of(text)
    except ValueError:
        return False
    return True
