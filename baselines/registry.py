"""Make controllers from the texts of the command line: a name, a user's class, or a file."""

from __future__ import annotations

import contextlib
import pickle
from collections import ChainMap
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from dcgrid_env import Scenario
from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.laws.constant_set_points import ConstantSetPoints, TwoTimescale
from dcgrid_env.baselines.laws.deadband import DeadbandDroop
from dcgrid_env.baselines.laws.droop import Droop
from dcgrid_env.baselines.laws.fixed_smoothing import PROFILES, FixedSmoothing
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.baselines.laws.peak_shaving import PeakShaving
from dcgrid_env.baselines.laws.request_sharing import RequestSharing
from dcgrid_env.baselines.laws.route_to_strongest import RouteToStrongest
from dcgrid_env.baselines.laws.site_return import ReturnByHand, StaggeredReturn
from dcgrid_env.baselines.laws.static import ConstantQ, PlacementRule
from dcgrid_env.baselines.laws.switching import SwitchingReference
from dcgrid_env.baselines.laws.volt_var import VoltVar
from dcgrid_env.baselines.model_aided.model_aided import ModelAided
from dcgrid_env.baselines.model_based.feedback import FeedbackOptimisation
from dcgrid_env.baselines.model_based.message_mpc import MessageMpc
from dcgrid_env.baselines.model_based.mpc import Mpc
from dcgrid_env.baselines.tuning.tunable import TUNABLE
from dcgrid_env.baselines.tuning.tuned import SUFFIX, tuned_controller, tuned_parameters
from dcgrid_env.baselines.user_code import CodeReference, OwnCodeError, described, load, parse, place
from dcgrid_env.core.plugins import Entry, Registry
from dcgrid_env.core.user_files import is_file
from dcgrid_env.core.work.unit import packed, shared

CARRIED = "controllers"
"""Name of the shared value with pickles of the user's controllers, by their text, on workers elsewhere."""


def _profile(name: str) -> Callable[[], Controller]:
    """Return a function that makes the law of power smoothing with a profile."""
    return lambda: FixedSmoothing(**PROFILES[name])


CONTROLLERS: dict[str, tuple[str, Callable[[], Controller]]] = {
    "none": ("top clock, no reactive power", NoControl),
    "inverters": ("reactive droop at the inverters alone, data centres uncontrolled", lambda: Droop(datacenters=False)),
    "droop": ("the paper's droop on both axes, k_p = 1 MW/p.u., k_q = 0.5 Mvar/p.u. s, alpha = 0.3 /s", Droop),
    "droop-q": ("the same without the active axis (k_p = 0)", lambda: Droop(k_p_mw_per_pu=0.0)),
    "droop-one-step": ("the paper's droop with its printed one-step memory", lambda: Droop(memory="one_step")),
    "droop-adaptive": (
        "the paper's droop with an alpha that grows with the backlog: 0.03 /s, doubled at 2 s of work",
        lambda: Droop(alpha_per_s=0.03, alpha_growth_per_s=0.5),
    ),
    "volt-var": ("the volt-var curve of IEEE 1547-2018, category B, with its response time of 5 s", VoltVar),
    "deadband": (
        "proportional reactive droop beyond 0.01 p.u. with a ramp limit of 10 % of the limit/s",
        DeadbandDroop,
    ),
    "switching": ("reactive droop to two references, for AI-training loads (arXiv 2603.15588)", SwitchingReference),
    "peak-shaving": (
        "storages hold their voltage above 0.95 p.u. and charge above it, the paper's droop beside them",
        PeakShaving,
    ),
    "route-to-strongest": (
        "work goes to the sites whose voltage will be high, the paper's droop beside it",
        RouteToStrongest,
    ),
    "request-sharing": (
        "sites meet a utility's request together, those with more queued work draw more; the paper's droop beside it",
        RequestSharing,
    ),
    "return-by-hand": (
        "sites that left the grid all return at once, a while after they are locked out; the paper's droop beside",
        ReturnByHand,
    ),
    "staggered-return": ("the same, one site after the other", StaggeredReturn),
    "smoothing": (
        "power smoothing at a floor of 65 % and ramps of a second to the rating, the paper's droop beside it",
        FixedSmoothing,
    ),
    "smoothing-light": ("the same with a floor of 50 % and ramps of half a second", _profile("light")),
    "smoothing-strong": ("the same with a floor of 90 % and ramps of two seconds", _profile("strong")),
    "constant-q": ("the same constant share of the reactive limit at every agent", ConstantQ),
    "placement": ("a constant share that is a linear function of R_ii and X_ii", PlacementRule),
    "set-points": (
        "constant set points of regulators and capacitor banks (default: the scenario's)",
        ConstantSetPoints,
    ),
    "static": ("the same and a constant share of the reactive limit for each agent (default: 0)", ConstantSetPoints),
    "two-timescale": (
        "constant set points, and reactive power that follows the local voltage: 10 times the deviation within 300 s",
        TwoTimescale,
    ),
    "model-aided": (
        "local measurements and the feeder's model: what is best for an estimate of all voltages from the own one",
        ModelAided,
    ),
    "feedback": (
        "online feedback optimisation: projected primal-dual steps on the measured voltages of all buses",
        FeedbackOptimisation,
    ),
    "mpc-one-step": ("model predictive control of the next step", lambda: Mpc(horizon=1)),
    "mpc-messages": (
        "the same with the voltages of the agents' buses alone, which the agents send to each other",
        MessageMpc,
    ),
    "mpc": ("model predictive control over 12 steps with preview and forecast", Mpc),
}
"""Description and factory of each controller that does not depend on the scenario, by name."""

TUNED: dict[str, str] = {
    f"{law}{SUFFIX}": f"{law}, its parameters tuned on the validation split of the scenario" for law in TUNABLE
}
"""Description of each controller whose parameters depend on the scenario, by name."""


class ForScenario(NamedTuple):
    """An entry of the registry whose controller depends on the scenario."""

    about: str
    """Short description of the controller."""
    make: Callable[..., Controller]
    """Function that makes a new controller from the scenario and a file of tuned parameters, or None."""


ENTRIES: ChainMap[str, Entry] = ChainMap(
    {name: ForScenario(about, partial(tuned_controller, name.removesuffix(SUFFIX))) for name, about in TUNED.items()},
    CONTROLLERS,
)
"""Registry entries of the controllers in this package: ``CONTROLLERS``, then ``TUNED``."""
CONTROLLER_REGISTRY = Registry("dcgrid.controllers", "controller", Controller, ENTRIES)
"""All named controllers: those of this package, policies, and those of other packages.

An entry is a pair of a description and a function without arguments that makes a new controller, or a ``ForScenario``.
A name that begins with a dot, such as ``.safetensors``, matches all files with that ending; its function takes the
path, and that of a ``ForScenario`` also the scenario, None if it is unknown, and the file of tuned parameters. A name
that ends in a colon, such as ``guarded:``, is a prefix of the text of another controller; its function takes that
controller, the scenario and the file of tuned parameters.
"""


def make_controller(name: str, scenario: Scenario | None = None, tuned: str | Path | None = None) -> Controller:
    """Make a new controller by its name.

    Parameters
    ----------
    name
        A name of ``CONTROLLER_REGISTRY``: of ``CONTROLLERS``, of ``TUNED``, of a policy, or of another package.
    scenario
        Scenario to drive; it selects the parameters of a tuned controller, and the policy if a name has one per preset.
    tuned
        A file of ``dcgrid tune`` that must contain the parameters; see ``tuned.tuned_parameters`` for the default.

    Raises
    ------
    ValueError
        If the name is unknown; the message suggests similar names. Also if the controller depends on the scenario and
        ``scenario`` is None or has no parameters for it. A ``PluginError`` if a controller of another package fails.
    """
    if name not in CONTROLLER_REGISTRY:
        raise ValueError(CONTROLLER_REGISTRY.unknown(name))
    if not isinstance(CONTROLLER_REGISTRY[name], ForScenario):
        return CONTROLLER_REGISTRY.make(name)
    if scenario is None:
        raise ValueError(f"controller {name!r} depends on the scenario; say which one it is for")
    return CONTROLLER_REGISTRY.make(name, scenario, tuned)


def find_controller(spec: str, scenario: Scenario, tuned: str | Path | None = None) -> Controller:
    """Make a new controller from its text on the command line.

    Parameters
    ----------
    spec
        One of three forms. A name, see ``make_controller``. A class, ``package.module:Class`` or
        ``path/to/file.py:Class``, with literals as arguments if it takes any, ``file.py:Class(gain=0.5)``; this runs
        the user's code, and modules of the working directory are found too. A saved policy, as the path of its
        .safetensors file, of the training run's folder that contains it, or of a Stable-Baselines3 zip; this does not
        run code. The prefix ``guarded:`` may precede a learned policy.
    scenario
        Scenario to drive; it selects the gains of a tuned controller.
    tuned
        A file of ``dcgrid tune`` that must contain the gains, see ``make_controller``.

    Raises
    ------
    ValueError
        If ``spec`` does not name a controller, or the controller has no gains for the scenario. An ``OwnCodeError`` if
        the user's code fails.
    """
    before, inner = split_prefix(spec)
    if before:
        return CONTROLLER_REGISTRY.make(before, find_controller(inner, scenario, tuned), scenario, tuned)
    if (carried := shared(CARRIED, {}).get(spec)) is not None:
        return pickle.loads(carried)
    require_known(spec)
    if parse(spec) is not None or controller_file(spec) is not None:
        return _own_controller(spec, scenario, tuned)
    return make_controller(spec, scenario, tuned)


def require_known(spec: str) -> None:
    """Raise ValueError if a text is neither a known name nor has the form of a file or of code."""
    if parse(spec) is None and controller_file(spec) is None and spec not in CONTROLLER_REGISTRY:
        raise ValueError(f"{CONTROLLER_REGISTRY.unknown(spec)}; or {_forms()}")


def _own_controller(spec: str, scenario: Scenario | None = None, tuned: str | Path | None = None) -> Controller:
    """Make a controller from a user's file or code; errors as of ``find_controller``."""
    reference = parse(spec)
    if reference is not None:
        controller = _construct(spec, reference, load(reference, f"controller {spec!r}"))
        if not isinstance(controller, Controller):
            raise ValueError(
                f"controller {spec!r}: {type(controller).__name__} is no controller; give it reset and act"
            )
        return controller
    file = controller_file(spec)
    assert file is not None
    if not is_file(file, ValueError):
        raise ValueError(f"controller {spec!r}: there is no file {file}; {_forms()}")
    further = (scenario, tuned) if isinstance(CONTROLLER_REGISTRY[file.suffix], ForScenario) else ()
    return CONTROLLER_REGISTRY.make(file.suffix, str(file), *further)


def own_controllers(specs: Iterable[str]) -> dict[str, bytes]:
    """Return pickles of new instances of the user's controllers among those that texts name; leave out invalid ones.

    Invalid ones are loaded on the worker, and the error is reported there.
    """
    controllers: dict[str, Controller] = {}
    for _, inner in map(split_prefix, specs):
        if parse(inner) is not None or controller_file(inner) is not None:
            with contextlib.suppress(ValueError):
                controllers[inner] = _own_controller(inner)
    return dict(zip(controllers, packed(controllers.values()), strict=True))


def split_prefix(spec: str) -> tuple[str, str]:
    """Split a text into its prefix, such as ``guarded:``, and the controller's name; the prefix may be empty.

    Raises ValueError if no name follows the prefix.
    """
    first, colon, rest = spec.partition(":")
    is_prefix = bool(colon) and first.isidentifier() and f"{first}:" in CONTROLLER_REGISTRY
    if is_prefix and not rest:
        raise ValueError(f"controller {spec!r}: nothing follows; write a policy's name or file behind it (dcgrid list)")
    return (f"{first}:", rest) if is_prefix else ("", spec)


def controller_file(spec: str) -> Path | None:
    """Return the file that a text names, whether it exists or not; None for a name or user code.

    Its ending is in the registry. For a folder, such as that of a training run, the file is ``policy`` with such an
    ending. ``spec`` has no prefix (``split_prefix``).
    """
    if spec in CONTROLLER_REGISTRY or parse(spec) is not None:
        return None
    path = Path(spec)
    if spec and path.is_dir():
        within = [path / f"policy{ending}" for ending in _endings()]
        return next((file for file in within if file.is_file()), within[0])
    return path if path.suffix and path.suffix in CONTROLLER_REGISTRY else None


def _endings() -> list[str]:
    """Return the endings of files that a controller can be read from, those of policies first."""
    return [name for name in CONTROLLER_REGISTRY if name.startswith(".")]


def _forms() -> str:
    """Explain how to specify a controller that is not in the registry."""
    return (
        "give package.module:Class or path/to/file.py:Class for one of your own, with its arguments in parentheses if "
        f"it takes any, a saved policy's {', '.join(_endings())} file, or the folder of a training run"
    )


def _construct(spec: str, reference: CodeReference, kind: object) -> object:
    if not callable(kind):
        raise ValueError(f"controller {spec!r}: {reference.name!r} of {reference.where} is no class; {_forms()}")
    try:
        return kind(*reference.positional, **dict(reference.keywords))
    except (Exception, SystemExit) as error:
        how = "" if reference.positional or reference.keywords else " without arguments"
        raise OwnCodeError(
            f"controller {spec!r}: constructing it{how} fails{place(error)}: {described(error)}"
        ) from error


def tuned_from(controllers: Sequence[str], scenario: Scenario, tuned: Path | None) -> list[str]:
    """Return a line for each tuned controller whose gains come from a file instead of the bundled gains."""
    laws = {name: name.removesuffix(SUFFIX) for name in controllers if name in TUNED}
    # A law that does not apply to the scenario has no gains.
    fitting = {name: law for name, law in laws.items() if TUNABLE[law].fits(scenario)}
    files = {name: tuned_parameters(law, scenario, tuned).file for name, law in fitting.items()}
    return [f"{name}: gains for {scenario.name} from {file}" for name, file in files.items() if file is not None]
