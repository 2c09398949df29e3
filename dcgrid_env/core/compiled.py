"""The decorator of all kernels: numba compiles them, and their machine code is kept in a cache folder of the user.

numba's cache writes next to the sources, where pip does not remove its files and a read-only installation has no
place for them. It also compares only the file of a kernel, not those of the kernels and constants that it uses. Here
the name of a file contains a hash of all of these, and the folder is that of ``kernel_files``.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import pickle
import platform
import sys
import time
import types
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import config, event, sigutils
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher
from numba.core.serialize import dumps

from dcgrid_env.core import kernel_files

_VERSIONS = (platform.python_version(), numba.__version__, llvmlite.__version__, np.__version__)
_SETTINGS = ("BOUNDSCHECK", "OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "DEBUGINFO_DEFAULT", "DISABLE_INTEL_SVML")
"""Settings of numba that change the code but not the name of the processor."""


COMPILATION_TAKES = "about 10 s for a balanced feeder and 30 s for a three-phase one"


def compiled(function: Callable[..., Any] | None = None, *, inner: bool = False, **options: Any) -> Any:
    """Compile a function at its first call for each kind of arguments, or load its machine code from the cache.

    Parameters
    ----------
    function
        The kernel. It uses global constants, other kernels and modules, and no variables of an enclosing function.
    inner
        Whether only other kernels call it. Such a kernel has no wrapper for calls from Python, which takes up to half
        of the time that it compiles; a call from Python raises TypeError.
    options
        Options of ``numba.njit``. Divisions by zero follow IEEE 754 (``error_model="numpy"``).
    """
    if function is None:
        return partial(compiled, inner=inner, **options)
    options = {"error_model": "numpy", "no_cfunc_wrapper": True, "no_cpython_wrapper": inner} | options
    kernel: Any = numba.njit(**options)(function)
    if kernel is not function:  # which it is under NUMBA_DISABLE_JIT
        kernel._cache = _Cache(kernel)
        if inner:
            kernel.__class__ = _Inner
    return kernel


class _Inner(CPUDispatcher):
    """A kernel without a wrapper for calls from Python, which would crash the process."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        raise TypeError(f"{self.__name__} is a kernel that only other kernels call (inner=True)")


def compiling_s() -> float:
    """Return the seconds that this process has spent compiling so far."""
    return _compiling.seconds()


class _Compiling(event.Listener):
    """Measure how long kernels take to compile, and report on stderr once that they do, where they are many."""

    MANY = 8

    def __init__(self) -> None:
        self._ended_s = self._began_s = 0.0
        self._depth = self._kernels = 0

    def seconds(self) -> float:
        return self._ended_s + (time.monotonic() - self._began_s if self._depth else 0.0)

    def on_start(self, event: Any) -> None:
        if self._depth == 0:
            self._began_s = time.monotonic()
        self._depth += 1
        self._kernels += isinstance(event.data["dispatcher"]._cache, _Cache)
        if self._kernels == self.MANY and multiprocessing.parent_process() is None:
            self._kernels += 1
            print(f"dcgrid: compiling kernels, once per installation; {COMPILATION_TAKES}.", file=sys.stderr)

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._ended_s += time.monotonic() - self._began_s


class _Cache(NullCache):
    """Machine code of one kernel, in the place where numba's dispatcher looks for it."""

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel

    def load_overload(self, sig: object, target_context: Any) -> Any:
        target_context.refresh()
        data = kernel_files.read(self._name(sig, target_context.codegen()))
        return None if data is None else CompileResult._rebuild(target_context, *pickle.loads(data))

    def save_overload(self, sig: object, cres: Any) -> None:
        if not cres.lifted and not cres.library.has_dynamic_globals:
            kernel_files.write(self._name(sig, cres.codegen), dumps(cres._reduce()))

    def _name(self, sig: object, codegen: Any) -> str:
        arguments, _ = sigutils.normalize_signature(sig)
        found = hashlib.sha256(repr((_VERSIONS, codegen.magic_tuple())).encode())
        for setting in _SETTINGS:
            found.update(f"{setting}={getattr(config, setting, None)};".encode())
        for argument in arguments:
            found.update(_of_type(argument).encode())
        for part in _of_kernel(self._kernel, set()):
            found.update(f"{part};".encode())
        return f"{self._kernel.__name__.strip('_')}-{found.hexdigest()[:32]}"


def _of_type(kind: Any) -> str:
    """Text of the type of an argument, fields and module of named tuples included: two of them may swap their names.

    A kernel's file also refers to the class of a named tuple by its module, so it cannot be read after the class moves.
    """
    named = f"{getattr(kind, 'instance_class', '')}{getattr(kind, 'fields', '')}"
    return f"{kind}{named}[{','.join(map(_of_type, getattr(kind, 'types', ())))}]"


def _of_kernel(kernel: Any, seen: set[int]) -> Iterator[str]:
    """Texts of all that the code of a kernel depends on: bytecode, options, constants and the kernels that it calls."""
    if id(kernel) in seen:
        return
    seen.add(id(kernel))
    function = kernel.py_func
    yield f"{function.__module__}.{function.__qualname__}{function.__defaults__}"
    for option, value in sorted(kernel.targetoptions.items()):
        yield f"{option}={sorted(value) if isinstance(value, set) else value}"
    if function.__closure__:
        raise TypeError(f"{function.__qualname__}: a kernel cannot use variables of an enclosing function")
    yield from _of_code(function.__code__, function.__globals__, seen)


def _of_code(code: types.CodeType, names: dict[str, Any], seen: set[int]) -> Iterator[str]:
    yield f"{code.co_code.hex()}{code.co_names}{code.co_varnames}"
    for constant in code.co_consts:
        yield from _of_value("constant", constant, names, seen)
    for name in code.co_names:
        if name in names:
            yield from _of_value(name, names[name], names, seen)


def _of_value(name: str, value: object, names: dict[str, Any], seen: set[int]) -> Iterator[str]:
    if isinstance(value, Dispatcher):
        yield from _of_kernel(value, seen)
    elif isinstance(value, types.CodeType):
        yield from _of_code(value, names, seen)
    elif isinstance(value, types.ModuleType):
        yield f"{name}: module {value.__name__}"
    elif isinstance(value, type):
        yield f"{name}: {value.__module__}.{value.__qualname__}{getattr(value, '_fields', '')}"
    elif isinstance(value, tuple):
        for item in value:
            yield from _of_value(name, item, names, seen)
        yield f"{name}: tuple of {len(value)}"
    elif isinstance(value, np.ndarray | np.generic):
        yield f"{name}: {value.dtype}{value.shape} {value.tobytes().hex()}"
    elif value is None or isinstance(value, bool | int | float | str):
        yield f"{name}: {type(value).__name__} {value!r}"
    else:
        raise TypeError(f"{name} is a {type(value).__name__}, which a kernel cannot use: give it a number or a tuple")


_compiling = _Compiling()
event.register("numba:compile", _compiling)
