"""Make scenarios from the texts of the command line: a preset or a user's scenario, with overrides for some fields.

    ieee33                          a preset, or a name that another package has registered
    path/to/own.py:make             a function without arguments that returns a Scenario, or a Scenario in that file
    package.module:make             the same in a module that can be imported
    horizon=60 weights={backlog=1}  fields, each with a value as in TOML or JSON; quotes around a text may be left out

Only this module converts such texts to scenarios; worker processes rebuild their scenarios from the same texts.
"""

from __future__ import annotations

import contextlib
import datetime
import shlex
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

from dcgrid_env import PRESETS, SCENARIO_REGISTRY, RandomFeeders, Scenario, ScenarioError, make_scenario
from dcgrid_env.baselines.source_voltage import CENTRED, centred_voltage, source_line, source_origin
from dcgrid_env.baselines.user_code import OwnCodeError, described, load, parse, place
from dcgrid_env.core.checked import shown
from dcgrid_env.core.user_files import parse_json, parse_toml
from dcgrid_env.core.work.unit import shared

FORMS = "path/to/file.py:function or package.module:function for one of your own, or path/to/file.toml"
CARRIED = "scenarios"
"""Name of the shared value with the user's scenarios, by their text, on workers elsewhere."""
_specs: WeakKeyDictionary[Scenario, ScenarioSpec] = WeakKeyDictionary()
"""Specification of each scenario that was made here."""


@dataclass(frozen=True)
class ScenarioSpec:
    """A scenario as named on the command line.

    Parameters
    ----------
    where
        A scenario's name, or ``file.py:function`` or ``package.module:function``.
    set
        ``FIELD=VALUE`` for each field to override.
    """

    where: str
    set: tuple[str, ...] = ()

    def make(self, split: str, **chosen: object) -> Scenario:
        """Make the scenario on a split; the same call returns the same object as long as a file has not changed.

        Parameters
        ----------
        split
            train, validation, test or ood.
        **chosen
            Fields that a command sets itself; they must not be in ``set`` as well.

        Raises
        ------
        ValueError
            If the text does not name a scenario, or a field or value is invalid; the message names it and what is
            allowed. An ``OwnCodeError`` if the user's code fails.
        """
        return _scenario_of(self, _base(self.where), split, tuple(chosen.items()))

    @property
    def is_preset(self) -> bool:
        """Whether the scenario is an unchanged preset."""
        return self.where in PRESETS and not self.set

    @property
    def label(self) -> str:
        """Label of the scenario in files: the preset's name, or the words of the command line."""
        return shlex.join((self.where, "--set", *self.set)) if self.set else self.where

    def options(self, flag: str) -> str:
        """Return the options that select the scenario, such as ``--scenario own.py:make --set horizon=60``."""
        return shlex.join((flag, self.where, *(("--set", *self.set) if self.set else ())))


def spec_of(scenario: Scenario) -> ScenarioSpec | None:
    """Return the specification of a scenario; None if ``ScenarioSpec.make`` did not make it."""
    return _specs.get(scenario)


def options_of(scenario: Scenario, flag: str) -> str:
    """Return the command-line options that select a scenario, with a placeholder for one that was made in Python."""
    spec = spec_of(scenario)
    return spec.options(flag) if spec else f"{flag} FILE.py:FUNCTION"


def read_overrides(texts: tuple[str, ...], option: str = "set") -> dict[str, Any]:
    """Parse texts ``FIELD=VALUE`` or ``PART.FIELD=VALUE`` into values by field.

    Raises ValueError for any other text or a field that is set twice; the message names the option.
    """
    overrides: dict[str, Any] = {}
    for text in texts:
        field, sign, value = text.partition("=")
        field = field.strip()
        if not sign or not all(map(str.isidentifier, field.split("."))):
            raise ValueError(f"{option}: {text!r} is no field with its value; write FIELD=VALUE, such as horizon=60")
        if field in overrides:
            raise ValueError(f"{option}: {field} is there twice, as {overrides[field]!r} and as {value}; give it once")
        overrides[field] = value.strip() if field == "name" else read_value(field, value.strip(), option)
    return overrides


def read_value(field: str, text: str, option: str = "set") -> Any:
    """Parse a value as TOML or JSON; return the text itself if it is neither and does not begin like one.

    None, True and False are also accepted as Python writes them, since messages contain them.
    """
    if text in ("None", "True", "False"):
        return {"None": None, "True": True, "False": False}[text]
    try:
        table = parse_toml(f"value = {text}", option, ValueError)
    except ValueError:
        with contextlib.suppress(ValueError):
            return parse_json(text, option, ValueError, "")
    else:
        if list(table) == ["value"]:
            value = table["value"]
            dated = isinstance(value, datetime.date | datetime.time)
            return text if dated else value
    if text[:1] in ("[", "{", '"', "'") or not text:
        raise ValueError(
            f"{option}: {field} is {shown(text)}, which can be read neither as TOML nor as JSON; write a number, true, "
            "false, a text, a list such as [18, 33] or a table such as {backlog=1}"
        )
    return text


def own_scenarios(wheres: Iterable[str]) -> dict[str, Scenario]:
    """Return the user's scenarios among those that comma-separated texts name; leave out invalid ones.

    Invalid ones are loaded again where units run, and the error is reported there.
    """
    scenarios: dict[str, Scenario] = {}
    for name in (name.strip() for where in wheres for name in ([where] if parse(where) else where.split(","))):
        with contextlib.suppress(ValueError):
            base = _base(name)
            if isinstance(base, Scenario):
                scenarios[name] = base
    return scenarios


def _base(where: str) -> str | Scenario:
    """Return the name of a registered scenario, or load the user's scenario."""
    if carried := shared(CARRIED, {}).get(where):
        return carried
    if where.endswith(".toml"):
        status = Path(where).stat() if Path(where).is_file() else None
        return _read(where, status and (status.st_mtime_ns, status.st_size))
    if where.endswith(".py"):
        raise ValueError(f"scenario {where!r}: say which function of it makes the scenario, {where}:make for instance")
    reference = parse(where)
    if reference is None and where in SCENARIO_REGISTRY:
        return where
    if reference is None or reference.positional or reference.keywords:
        raise ScenarioError(f"{SCENARIO_REGISTRY.unknown(where)}; or give {FORMS}")
    loaded = load(reference, f"scenario {where!r}")
    scenario = _called(where, loaded) if callable(loaded) else loaded
    if not isinstance(scenario, Scenario):
        raise ValueError(
            f"scenario {where!r} is of type {type(scenario).__name__}; it must be a Scenario, or a function that "
            "gives one"
        )
    return scenario


@lru_cache(maxsize=64)
def _read(where: str, status: tuple[int, int] | None) -> Scenario:
    """Read a scenario file, again if it has changed."""
    return make_scenario(where)


@lru_cache(maxsize=64)
def _called(where: str, function: Callable[[], Any]) -> Any:
    """Return the result of a user's function, called once and again if its file has changed."""
    try:
        return function()
    except (Exception, SystemExit) as error:
        raise OwnCodeError(f"scenario {where!r} fails{place(error)}: {described(error)}") from error


@lru_cache(maxsize=64)
def _scenario_of(spec: ScenarioSpec, base: str | Scenario, split: str, chosen: tuple[tuple[str, Any], ...]) -> Scenario:
    """Return the scenario, one object for each specification, so that derived data is shared."""
    scenario = varied(base, spec.set, split, dict(chosen))
    _specs[scenario] = spec
    return scenario


def varied(base: str | Scenario, texts: tuple[str, ...], split: str, chosen: Mapping[str, Any]) -> Scenario:
    """Make a scenario on a split with the fields that the user sets and those that a command sets itself.

    ``source_voltage_pu=centred`` asks for ``centred_voltage``. Raises ValueError for an invalid field or value, or a
    field that both set; the message names it and the remedy.
    """
    overrides = read_overrides(texts)
    if "split" in overrides:
        raise ValueError("set: split is chosen by the command, with --split where it takes one; leave it out")
    for field in chosen:
        if field in overrides:
            raise ValueError(f"set: {field} is chosen by an option of the command; leave one of them out")
    is_centred = isinstance(overrides.get("source_voltage_pu"), str)
    if is_centred and (word := overrides.pop("source_voltage_pu")) != CENTRED:
        raise ValueError(f"set: source_voltage_pu is {word!r}; give a voltage in p.u., or {CENTRED}")
    try:
        scenario = make_scenario(base, **overrides, **chosen, split=split)
    except (TypeError, OverflowError, MemoryError) as error:
        is_field = not str(error).startswith("no scenario field")
        raise ValueError(f"set: {f'{shlex.join(texts)} cannot be: ' * is_field}{error}") from None
    if not is_centred:
        return scenario
    if isinstance(scenario.feeder, RandomFeeders):
        raise ValueError(f"set: source_voltage_pu is {CENTRED!r} on random feeders; give a number")
    return scenario.replace(source_voltage_pu=centred_voltage(scenario).v_pu)


def voltage_line(scenario: Scenario, overrides: tuple[str, ...], name: str | None) -> str:
    """Return a line with the source voltage and where it comes from; ``name`` is the scenario that the user named."""
    requested = read_overrides(overrides).get("source_voltage_pu")
    return source_line(scenario, source_origin(scenario, requested, name))
