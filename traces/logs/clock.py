"""Times of a reading as files write them: seconds since 1970, or a date and time."""

from datetime import UTC, datetime

from dcgrid_env.traces.checks import TraceError

FORMS = "2026-01-02T03:04:05.678Z or 1767323045.678 (s since 1970)"


def seconds(text: str | float, where: str) -> float:
    """Time since 1970, s, of a number of seconds or an ISO 8601 date and time; without an offset it counts as UTC.

    A date and a time may be separated by `T`, a space or `_`. Raises TraceError, with `where` at its beginning, for
    another text.
    """
    try:
        return float(text)
    except (TypeError, ValueError):
        pass
    try:
        at = datetime.fromisoformat(str(text).strip().replace("_", "T").replace("/", "-"))
    except ValueError:
        raise TraceError(f"{where}: the time is {str(text)[:40]!r}; write it like {FORMS}") from None
    return (at if at.tzinfo else at.replace(tzinfo=UTC)).timestamp()


def is_date(text: str) -> bool:
    """Return whether a text is a date and time, and not a number."""
    try:
        float(text)
    except ValueError:
        try:
            seconds(text, "")
        except TraceError:
            return False
        return True
    return False
