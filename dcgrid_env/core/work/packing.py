"""Pickles for workers, which may lack the modules that a user's own objects come from."""

from __future__ import annotations

import sys
import sysconfig
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import cloudpickle

_OURS = __name__.partition(".")[0]


def packed(value: object) -> bytes:
    """A pickle of a value that carries functions and classes of the user's own modules whole, not by their names."""
    (only,) = all_packed([value])
    return only


def all_packed(values: Iterable[Any]) -> list[bytes]:
    """Pickles as of ``packed``; the user's modules are looked for once."""
    with _by_value(_own_modules()):
        return [cloudpickle.dumps(value) for value in values]


def _own_modules() -> list[ModuleType]:
    """Imported modules that are neither installed nor of this package: workers elsewhere do not have them."""
    return [
        module
        for name, module in list(sys.modules.items())
        if name.partition(".")[0] not in (_OURS, "__main__") and isinstance(module, ModuleType)
        if (file := getattr(module, "__file__", None)) and not _is_installed(Path(file))
    ]


def _is_installed(file: Path) -> bool:
    library = Path(sysconfig.get_paths()["stdlib"])
    return library in file.parents or bool({"site-packages", "dist-packages"} & set(file.parts))


@contextmanager
def _by_value(modules: list[ModuleType]) -> Iterator[None]:
    registered = cloudpickle.list_registry_pickle_by_value()
    new = [module for module in modules if module.__name__ not in registered and module.__name__ in sys.modules]
    for module in new:
        cloudpickle.register_pickle_by_value(module)
    try:
        yield
    finally:
        for module in new:
            cloudpickle.unregister_pickle_by_value(module)
