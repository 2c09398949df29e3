"""Names of keywords in error messages, as options of the command line.

Messages name keywords as Python shows them: ``pass gaps='hold'``, ``max_gap_s = 15; raise max_gap_s``. The command line
prints ``--gaps hold`` and ``--max-gap-s`` instead. Options of files that a command does not have, such as ``--unit``
of `dcgrid run`, exist in `dcgrid traces check`, which writes a file that all commands read.
"""

from __future__ import annotations

import dataclasses
import re

READING = frozenset(
    (
        "unit",
        "power_columns",
        "metric",
        "step_s",
        "part_s",
        "invalid",
        "gaps",
        "max_gap_s",
        "limit_kw",
        "gpus",
        "columns",
    )
)
"""Keywords of the readers of recordings; each is an option of `dcgrid traces check`."""
_CHECK = "`dcgrid traces check FILE --save NEW.csv` has {options}; use the new file"

_VALUE = r"'[^']*'(?: or '[^']*')*|[-+]?[\w.]*\w"
_AFTER_VERB = re.compile(r"(?P<verb>\b(?:pass|raise|correct|leave) )(?P<name>[a-z_]+)\b(?!=| =)")
"""A keyword after a verb, without a value."""


def with_options(error: BaseException, command: object) -> str:
    """Return the message of an error with the keywords that are options as options.

    Parameters
    ----------
    error
        Error of a command.
    command
        The command, a dataclass whose fields are its options; None if the command line was not read.
    """
    message = str(error)
    fields = {field.name for field in dataclasses.fields(command)} if dataclasses.is_dataclass(command) else set()
    known = {name for name in fields if f"pass {name}=" in message} | (READING if _comes_from_file(error) else set())
    if not known:
        return message
    names = sorted(known, key=len, reverse=True)
    keyword = re.compile(rf"(?<![\w.'\"/-])(?<!--set )({'|'.join(names)})(?: = ?|=)(?P<value>{_VALUE}|)")
    worded = "|".join(name for name in names if "_" in name) or "(?!)"
    lonely = re.compile(rf"(?<![\w.'\"/-])(?:{worded})(?![\w'\"=]| =)")
    used: list[str] = []

    def option(name: str, value: str = "") -> str:
        used.append(name)
        return f"--{name.replace('_', '-')} {value.replace(chr(39), '')}".strip()

    def translated(text: str) -> str:
        text = keyword.sub(lambda match: option(match[1], match["value"]), text)
        text = lonely.sub(lambda match: option(match[0]), text)
        return _AFTER_VERB.sub(
            lambda match: match["verb"] + (option(match["name"]) if match["name"] in names else match["name"]), text
        )

    parts = message.split("`")
    parts[::2] = map(translated, parts[::2])
    lacking = list(dict.fromkeys(name for name in used if name not in fields))
    text = "`".join(parts)  # commands between backquotes stay
    if lacking:
        text += f"; {_CHECK.format(options=' and '.join(map(option, lacking)))}"
    return text


def _comes_from_file(error: BaseException | None) -> bool:
    """Return whether a reader of a recording raised an error or its cause."""
    while error is not None:
        if any(kind.__name__ == "TraceError" for kind in type(error).__mro__):
            return True
        error = error.__cause__ or error.__context__
    return False
