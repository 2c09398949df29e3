"""A controller as the command line names it: one that ships, a class of the user's own, or a saved policy."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from dcgrid_env import PRESETS, Scenario
from dcgrid_env.agents.policy import SHIPPED, SUFFIX, Policy
from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.named import CONTROLLERS, TUNED, make_controller

FORMS = f"give package.module:Class or path/to/file.py:Class for one of your own, or a saved policy's {SUFFIX} file"


def preset_of(policy: str) -> str | None:
    """The preset that a policy's name begins with, the longest such; None where it begins with none."""
    return max((name for name in PRESETS if policy.startswith(f"{name}-")), key=len, default=None)


def _trained(shipped: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Shipped policies by what they are called on every preset: ``PRESET-NAME`` is NAME there."""
    found: dict[str, tuple[str, ...]] = {}
    for policy in shipped:
        if preset := preset_of(policy):
            name = policy.removeprefix(f"{preset}-")
            found[name] = (*found.get(name, ()), preset)
    return found


TRAINED = _trained(SHIPPED)
"""Names that stand for the policy trained on the scenario at hand, with the presets that have one."""
NAMES = (*CONTROLLERS, *TUNED, *TRAINED)
"""All that a benchmark of everything runs; ``SHIPPED`` policies can be named besides."""


def find_controller(spec: str, scenario: Scenario) -> Controller:
    """A fresh controller for a scenario.

    Parameters
    ----------
    spec
        A name (``NAMES``, ``SHIPPED``); ``package.module:Class`` or ``path/to/file.py:Class``, constructed without
        arguments (this runs the user's code; modules of the working directory are found too); or the path of a saved
        policy, ending in .safetensors (this runs no code).
    scenario
        What it is to drive; tuned controllers look up their gains by it.

    Raises
    ------
    ValueError
        For a spec that names nothing, or something that is no controller, or one that has no gains for the scenario.
    """
    if spec in CONTROLLERS or spec in TUNED:
        return make_controller(spec, scenario)
    if spec in SHIPPED:
        return Policy.load(spec)
    if spec in TRAINED:
        if scenario.name not in TRAINED[spec]:
            there = ", ".join(TRAINED[spec])
            raise ValueError(f"controller {spec!r}: none ships for {scenario.name!r}, but for {there}; train one")
        return Policy.load(f"{scenario.name}-{spec}")
    if spec.endswith(SUFFIX):
        if not Path(spec).is_file():
            raise ValueError(f"controller {spec!r}: there is no such file; {FORMS}")
        return Policy.load(spec)
    where, colon, name = spec.rpartition(":")
    if not colon:
        raise ValueError(f"unknown controller {spec!r}; there are {', '.join((*NAMES, *SHIPPED))}; or {FORMS}")
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
