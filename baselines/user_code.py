"""Load user code that the command line names: ``path/to/file.py:NAME`` or ``package.module:NAME``.

A controller's class may be followed by arguments, ``file.py:Class(gain=0.5, mode=fast)``. Only literals are allowed;
they are parsed and never executed. A file is imported once in a process, and again if its content has changed.
"""

from __future__ import annotations

import ast
import hashlib
import importlib
import importlib.util
import re
import sys
import sysconfig
import traceback
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from dcgrid_env.core.user_files import is_file, read_bytes

_REFERENCE = re.compile(r"(?P<where>.+?):(?P<name>[A-Za-z_]\w*)(?P<arguments>\(.*\))?", re.DOTALL)
_LONGEST = 300
_files: dict[Path, tuple[str, ModuleType]] = {}
"""Files that this process has imported, with the digest of the content and the module."""


class OwnCodeError(ValueError):
    """Error of user code that fails; the message is one line, and the original exception is the cause."""

    traced = True
    """Whether a traceback contains more information than the message."""


class CodeReference(NamedTuple):
    """Parsed form of a text such as ``file.py:Class(gain=0.5)``."""

    where: str
    """Path of a file, or dotted name of a module."""
    name: str
    positional: tuple[Any, ...] = ()
    keywords: tuple[tuple[str, Any], ...] = ()

    @property
    def path(self) -> Path | None:
        """Path of the file; None for a module."""
        return Path(self.where) if self.where.endswith(".py") else None


def parse(spec: str) -> CodeReference | None:
    """Parse a text; return None if it does not have this form, raise ValueError for arguments other than literals."""
    match = _REFERENCE.fullmatch(spec.strip())
    if match is None:
        return None
    return CodeReference(match["where"], match["name"], *_arguments(spec, match["arguments"]))


def _arguments(spec: str, text: str | None) -> tuple[tuple[Any, ...], tuple[tuple[str, Any], ...]]:
    if text is None:
        return (), ()
    try:
        call = ast.parse(f"_{text}", mode="eval").body
        if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name):
            raise ValueError("they are no list of arguments")
        keywords = [(argument.arg, _literal(argument.value)) for argument in call.keywords]
        if None in dict(keywords) or len(dict(keywords)) < len(keywords):
            raise ValueError("each has a name of its own, and ** has no meaning here")
        return tuple(map(_literal, call.args)), tuple((str(name), value) for name, value in keywords)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise ValueError(
            f"{spec!r}: the arguments cannot be read ({one_line(error)}); give literals, such as "
            "(gain=0.5, buses=[3, 5], mode='fast')"
        ) from None


def _literal(node: ast.expr) -> Any:
    """Return the value of a literal; a bare word is a string, since shells remove quotes."""
    if isinstance(node, ast.Name):
        return node.id
    try:
        return ast.literal_eval(node)
    except ValueError:
        raise ValueError(f"{ast.unparse(node)!r} is no literal") from None


def load(reference: CodeReference, subject: str) -> object:
    """Import the module of a reference and return the named object.

    Parameters
    ----------
    reference
        Reference to the object.
    subject
        Beginning of error messages, for example ``controller 'own.py:Law'``.

    Raises
    ------
    ValueError
        If the file does not exist or does not define that name.
    OwnCodeError
        If the import fails.
    """
    if reference.path and not is_file(reference.path, ValueError):
        raise ValueError(f"{subject}: there is no file {reference.where}; give the path of one")
    try:
        module = _from_file(reference.path) if reference.path else _from_module(reference.where)
    except (Exception, SystemExit) as error:
        raise OwnCodeError(f"{subject}: importing {reference.where} fails{place(error)}: {described(error)}") from error
    if not hasattr(module, reference.name):
        defined_names = [
            name for name, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__
        ]
        raise ValueError(
            f"{subject}: {module.__file__} has no {reference.name!r}; it has {', '.join(defined_names) or 'nothing'}"
        )
    return getattr(module, reference.name)


def _from_module(dotted: str) -> ModuleType:
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.append(folder)
    return importlib.import_module(dotted)


def _from_file(path: Path) -> ModuleType:
    path = path.resolve()
    text = read_bytes(path, ValueError)
    digest = hashlib.sha256(text).hexdigest()
    if path in _files and _files[path][0] == digest:
        return _files[path][1]
    # Named after the content, so that two files of the same name do not replace each other.
    spec = importlib.util.spec_from_file_location(f"dcgrid_user_{path.stem}_{digest[:16]}", path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses and pickle look for it
    try:
        # Without Python's files of byte code, which miss a change of the same length within a second.
        exec(compile(text, path, "exec"), vars(module))
    except BaseException:
        del sys.modules[spec.name]
        raise
    _files[path] = digest, module
    return module


def place(error: BaseException) -> str:
    """Describe where user code raised an error, ``, own.py line 12``; empty if the traceback has no user code."""
    location = ""
    for frame, line in traceback.walk_tb(error.__traceback__):
        file, module = Path(frame.f_code.co_filename), str(frame.f_globals.get("__name__", ""))
        ours = module == "dcgrid_env" or module.startswith("dcgrid_env.")
        if file.suffix == ".py" and not ours and not _is_installed(file):
            location = f", {file.name} line {line}"
    return location


def _is_installed(file: Path) -> bool:
    """Whether a file belongs to Python's standard library or an installed package."""
    library = Path(sysconfig.get_paths()["stdlib"])
    return library in file.parents or bool({"site-packages", "dist-packages"} & set(file.parts))


def described(error: BaseException) -> str:
    """Return the type and message of an error on one line."""
    text = one_line(error)
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def one_line(error: BaseException) -> str:
    """Return the message of an error on one line, shortened if it is very long."""
    text = " ".join(str(error).split())
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."
