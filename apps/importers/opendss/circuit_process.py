"""Read three-phase circuits in a child process, because some files crash OpenDSS or need too much time or memory.

The child imports this package, reads the circuit and writes tables as JSON; none of its failures is the caller's.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Collection
from dataclasses import asdict
from pathlib import Path
from typing import Any, get_type_hints

from dcgrid_env.apps.importers.import_report import Finding
from dcgrid_env.apps.importers.opendss.dss_losses import LossEffect
from dcgrid_env.apps.importers.opendss.dss_shapes import imported_profiles
from dcgrid_env.apps.importers.opendss.reading import Imported, read_circuit
from dcgrid_env.core.work.unit import ONE_THREAD
from dcgrid_env.grid.network import Network
from dcgrid_env.grid.topology import FeederError

LONGEST_S = 300.0
"""Time that reading may take, s; the largest public circuits take some seconds."""
LARGEST_MEMORY_BYTES = 4 * 2**30
"""Address space of the child, where the operating system limits it; the largest public circuits take 0.5 GiB."""
_UNLIMITED = "if you trust the file, --trust reads it without limits of time and memory"
_CRASHES = "leave elements out to find the one that OpenDSS cannot read"
_WATCH_S = 0.5
_VOLTAGES = ("v_pu", "v_pu_without")


def read_opendss(
    master: str | Path, *, allow: Collection[str] = (), trust: bool = False, root: str | Path | None = None
) -> Imported:
    """Read a three-phase circuit; needs OpenDSSDirect.py, of the extra ``opendss``.

    Parameters
    ----------
    master
        File that defines the circuit, by itself or by what it redirects to.
    allow
        Kinds of elements, such as ``"capcontrol"`` or ``"generator"``, that may be left out although something is lost.
    trust
        Let OpenDSS run the script unchanged, without limits of time and memory. Otherwise the script is checked first.
        Commands that show or write results are left out. Others that go beyond a model's definition, or read files
        outside ``root``, are refused.
    root
        Folder below which the script may read files, such as that of a whole repository; by default the master file's.

    Raises
    ------
    FeederError
        If a command is refused, naming file and line. If elements cannot be represented, or are lost and not
        allowed, naming them. If OpenDSS crashes, or takes more than ``LONGEST_S`` or ``LARGEST_MEMORY_BYTES``.
        If OpenDSSDirect.py is missing.
    """
    options = {"trust": trust, "root": None if root is None else str(root)}
    return read_in_child(read_circuit, str(master), allow, options, _UNLIMITED, is_limited=not trust)


def read_in_child(
    read: Callable[..., Imported],
    file: str,
    allow: Collection[str],
    options: dict[str, Any],
    remedy: str,
    *,
    is_limited: bool = True,
) -> Imported:
    """Return what a function of a module reads from a file, with limits of time and memory.

    Parameters
    ----------
    read
        Function at the top of its module, which the child calls with the file, ``allow`` and the options.
    file, allow, options
        Its arguments; options by name, as plain values.
    remedy
        What to do about a file that takes too much time or memory.
    is_limited
        Whether the limits hold.

    Raises
    ------
    FeederError
        If the function raises it, or if the child crashes or exceeds ``LONGEST_S`` or ``LARGEST_MEMORY_BYTES``.
    """
    # The child finds modules where this process does.
    code = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import main; main()"
    wanted = {"module": read.__module__, "function": read.__name__, "file": file, "remedy": remedy,
              "options": options | {"allow": list(allow)}, "parent": os.getpid(),
              "longest_s": LONGEST_S if is_limited else None,
              "most_bytes": LARGEST_MEMORY_BYTES if is_limited else None}  # fmt: skip
    child = subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ | ONE_THREAD,
    )
    try:
        said, errors = child.communicate(json.dumps(wanted).encode(), wanted["longest_s"])
    except subprocess.TimeoutExpired:
        raise FeederError(f"{file}: reading it took more than {LONGEST_S:g} s; {remedy}") from None
    finally:  # on Ctrl-C and SIGTERM too
        child.kill()
        child.wait()
        for pipe in (child.stdout, child.stderr):
            if pipe:
                pipe.close()
    if child.returncode:
        raise FeederError(_crashed(file, child.returncode, errors.decode(errors="replace")))
    answer = json.loads(said)
    if "error" in answer:
        failed = FeederError(answer["error"])
        failed.add_note(answer["trace"])
        raise failed
    return _imported(answer)


def _crashed(file: str, code: int, errors: str) -> str:
    how = f"ended with exit code {code}"
    if code < 0:
        with contextlib.suppress(ValueError):
            how = f"crashed with {signal.Signals(-code).name}"
    said = f" ({errors.strip().splitlines()[-1]})" if errors.strip() else ""
    return f"{file}: the process that reads it {how}{said}; {_CRASHES}"


def _imported(answer: dict[str, Any]) -> Imported:
    kinds = get_type_hints(Network)
    tables = {
        name: kinds[name](**{column: _tuples(values) for column, values in value.items()})
        if isinstance(value, dict)
        else value
        for name, value in answer["network"].items()
    }
    findings = tuple(Finding(**row | {"names": tuple(row["names"])}) for row in answer["findings"])
    voltages = {field: {node: complex(*v) for node, v in answer[field].items()} for field in _VOLTAGES}
    effects = tuple(LossEffect(**row | {"kinds": tuple(row["kinds"])}) for row in answer["effects"])
    files = tuple((name, digest) for name, digest in answer["files"])
    return Imported(
        Network(**tables),
        findings,
        **voltages,
        effects=effects,
        files=files,
        engine=answer["engine"],
        profiles=imported_profiles(answer["profiles"]),
    )


def _tuples(values: object) -> Any:
    return tuple(map(_tuples, values)) if isinstance(values, list) else values


def main() -> None:
    """Read the circuit that standard input names, and write it, or what is wrong, to standard output."""
    wanted = json.load(sys.stdin)
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as out:
        for stream in (1, 2):  # what OpenDSS prints is nobody's
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
        longest_s = math.inf if wanted["longest_s"] is None else wanted["longest_s"]
        threading.Thread(target=_end_without, args=(wanted["parent"], longest_s), daemon=True).start()
        read = getattr(importlib.import_module(wanted["module"]), wanted["function"])
        if wanted["most_bytes"] is not None:
            _limit_memory(wanted["most_bytes"])
        json.dump(_answer(read, wanted), out)


def _answer(read: Callable[..., Imported], wanted: dict[str, Any]) -> dict[str, Any]:
    file = wanted["file"]
    try:
        imported = read(file, **wanted["options"])
    except FeederError as error:
        said = str(error)
    except MemoryError:
        most = f" than {wanted['most_bytes'] / 2**30:g} GiB" if wanted["most_bytes"] else " than there is"
        said = f"{file}: reading it takes more memory{most}; {wanted['remedy']}"
    except Exception as error:
        said = f"{file}: reading it ended in {type(error).__name__}: {' '.join(str(error).split())}; report the file"
    else:
        voltages = {
            field: {node: (v.real, v.imag) for node, v in getattr(imported, field).items()} for field in _VOLTAGES
        }
        return asdict(imported) | voltages
    return {"error": said, "trace": traceback.format_exc()}


def _end_without(parent: int, longest_s: float) -> None:
    """End this process once its parent was killed, or its time is up where that cannot be seen (Windows)."""
    end = time.monotonic() + longest_s
    while os.getppid() == parent and time.monotonic() < end:
        time.sleep(_WATCH_S)
    os._exit(1)


def _limit_memory(most_bytes: int) -> None:
    """Limit the address space where the operating system can, and leave no memory image behind."""
    try:
        import resource
    except ImportError:  # Windows
        return
    for limit, value in ((resource.RLIMIT_AS, most_bytes), (resource.RLIMIT_CORE, 0)):
        with contextlib.suppress(ValueError, OSError):  # above a limit that is set, or not known to the system
            resource.setrlimit(limit, (value, value))
