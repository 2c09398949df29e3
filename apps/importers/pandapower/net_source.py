"""Where a pandapower net comes from: a name of its example networks, SimBench, a JSON file, or an object of
Python's."""

from __future__ import annotations

import copy
import importlib
import inspect
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.pandapower.net_json import net_from_json
from dcgrid_env.apps.importers.pandapower.net_schema import PandapowerNet
from dcgrid_env.core.suggestions import from_clone
from dcgrid_env.core.user_files import require_regular
from dcgrid_env.grid.topology import FeederError


def loaded_net(source: object, arguments: Mapping[str, Any], trust: bool, report: Report) -> tuple[str, Any]:
    """Return the name of a net and a separate copy of the net.

    Raises FeederError if the net cannot be loaded or pandapower is not installed.
    """
    try:
        import pandapower
    except ImportError:
        raise FeederError(f"pandapower is missing; {from_clone('pandapower')}") from None
    if isinstance(source, str | Path):
        text = str(source)
        if text.endswith(".json") or Path(text).is_file():
            if arguments:
                raise FeederError("arguments are of networks that functions make; a file has none")
            return text, _from_file(Path(text), trust, report)
        return text, _build_net(text, arguments)
    if not isinstance(source, pandapower.pandapowerNet):
        raise FeederError(
            f"{type(source).__name__} is no pandapower net; give a net, the name of an example or a .json path"
        )
    return str(source.name or "net"), copy.deepcopy(source)


def _from_file(path: Path, trust: bool, report: Report) -> PandapowerNet:
    if not trust:
        return net_from_json(path, report)
    import pandapower

    require_regular(path, FeederError)
    try:
        return pandapower.from_json(str(path))
    except Exception as error:
        raise FeederError(f"{path}: pandapower cannot read it ({type(error).__name__}: {str(error)[:200]})") from None


def _build_net(name: str, arguments: Mapping[str, Any]) -> PandapowerNet:
    """The network that a function of ``pandapower.networks`` makes, or SimBench's of a code."""
    import pandapower.networks

    make = _functions(pandapower.networks).get(name)
    if make is None and name.count("-") >= 3:
        return _simbench(name)
    if make is None:
        near = [other for other in sorted(_functions(pandapower.networks)) if name.lower() in other]
        hint = f"; do you mean {', '.join(near[:5])}?" if near else "; pandapower.networks lists them"
        raise FeederError(f"{name!r} is no network of pandapower's, no SimBench code and no file{hint}")
    known = inspect.signature(make).parameters
    for argument in arguments:
        takes_any = any(p.kind is p.VAR_KEYWORD for p in known.values())
        if argument not in known and not takes_any:
            raise FeederError(f"{name} has no argument {argument!r}; it has {', '.join(known) or 'none'}")
    try:
        net = make(**arguments)
    except Exception as error:
        raise FeederError(f"{name} makes no network ({type(error).__name__}: {str(error)[:200]})") from None
    import pandapower

    if not isinstance(net, pandapower.pandapowerNet):
        raise FeederError(
            f"{name} makes {type(net).__name__}, not one network; write one by pandapower.to_json and import that"
        )
    net["name"] = net.name or name.removeprefix("create_")
    return net


def _functions(module: ModuleType) -> dict[str, Any]:
    """Functions that make networks, by name."""
    return {
        name: one
        for name, one in vars(module).items()
        if inspect.isfunction(one) and one.__module__.startswith("pandapower.networks.") and not name.startswith("_")
    }


def _simbench(code: str) -> PandapowerNet:
    try:
        # Optional, and not in the extra `dev`: a plain import would be an error to a type checker there.
        simbench = importlib.import_module("simbench")
    except ImportError:
        raise FeederError(
            f"{code!r} looks like a SimBench code, but simbench is missing; install it by `pip install simbench`"
        ) from None
    if code not in simbench.collect_all_simbench_codes():
        raise FeederError(f"{code!r} is no code of SimBench's; simbench.collect_all_simbench_codes() lists them")
    net = simbench.get_simbench_net(code)
    net["name"] = code
    return net
