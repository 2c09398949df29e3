"""A controller as the command line names it: one that ships, a class of the user's own, or a saved policy."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from dcgrid_env import Scenario
from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.named import CONTROLLERS, TUNED, make_controller
from dcgrid_env.baselines.policy import load_policy

NAMES = (*CONTROLLERS, *TUNED)
"""All that ship."""
FORMS = "give package.module:Class or path/to/file.py:Class for one of your own, or a saved policy's .npz file"


def find_controller(spec: str, scenario: Scenario) -> Controller:
    """A fresh controller for a scenario.

    Parameters
    ----------
    spec
        A name (``NAMES``); ``package.module:Class`` or ``path/to/file.py:Class``, constructed without arguments
        (this runs the user's code; modules of the working directory are found too); or the path of a saved policy,
        ending in .npz (this runs no code).
    scenario
        What it is to drive; tuned controllers look up their gains by it.

    Raises
    ------
    ValueError
        For a spec that names nothing, or something that is no controller, or one that has no gains for the scenario.
    """
    if spec in CONTROLLERS or spec in TUNED:
        return make_controller(spec, scenario)
    if spec.endswith(".npz"):
        if not Path(spec).is_file():
            raise ValueError(f"controller {spec!r}: there is no such file; {FORMS}")
        return load_policy(spec)
    where, colon, name = spec.rpartition(":")
    if not colon:
        raise ValueError(f"unknown controller {spec!r}; there are {', '.join(NAMES)}; or {FORMS}")
    made = _construct(spec, _module(spec, where), name)
    if not isinstance(made, Controller):
        raise ValueError(f"controller {spec!r}: {type(made).__name__} is no controller; give it reset and act")
    return made


def _module(spec: str, where: str) -> ModuleType:
    try:
        if where.endswith(".py"):
            return _from_file(Path(where))
        here = str(Path.cwd())
        if here not in sys.path:
            sys.path.append(here)
        return importlib.import_module(where)
    except FileNotFoundError:
        raise ValueError(f"controller {spec!r}: there is no file {where}; {FORMS}") from None
    except (Exception, SystemExit) as error:
        raise ValueError(f"controller {spec!r}: importing {where} fails: {type(error).__name__}: {error}") from error


def _from_file(path: Path) -> ModuleType:
    found = importlib.util.spec_from_file_location(f"dcgrid_user_{path.stem}", path)
    if found is None or found.loader is None:
        raise FileNotFoundError(path)
    module = importlib.util.module_from_spec(found)
    sys.modules[found.name] = module  # where dataclasses and pickle look for it
    found.loader.exec_module(module)
    return module


def _construct(spec: str, module: ModuleType, name: str) -> object:
    kind = getattr(module, name, None)
    if not callable(kind):
        raise ValueError(f"controller {spec!r}: {module.__file__} has no class {name!r}; {FORMS}")
    try:
        return kind()
    except (Exception, SystemExit) as error:
        raise ValueError(
            f"controller {spec!r}: constructing it without arguments fails: {type(error).__name__}: {error}"
        ) from error
