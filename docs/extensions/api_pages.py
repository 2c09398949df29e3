"""The API reference: groups by task, and a page for each module with public names, made when the site is built."""

from __future__ import annotations

import inspect
import re
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from public_names import API, public_by_origin, text_of_data
from sphinx.application import Sphinx


class Group(NamedTuple):
    """Modules that a task needs."""

    title: str
    about: str
    """What a reader does with them, as reStructuredText."""
    modules: tuple[str, ...]
    """Modules or packages below ``dcgrid_env``, in the order of the page. The longest one that fits a module counts."""


GROUPS = (
    Group(
        "Make an environment",
        "Create an environment of a preset and read its spaces (:doc:`guide <../environments>`).",
        (
            "scenario.presets",
            "envs.single",
            "envs.vector",
            "envs.parallel",
            "envs.tensor",
            "envs",
            "engine.cost.observation",
            "engine.physics.actions",
        ),
    ),
    Group(
        "Define a scenario",
        "Change a preset, or define all parts of a scenario (:doc:`guide <../scenarios>`).",
        (
            "scenario.scenario",
            "scenario",
            "scenario.costs.voltage_reference",
            "devices.faults",
            "devices.ride_through.sags",
        ),
    ),
    Group(
        "Write a controller",
        "Derive a class from an interface, use a bundled law, and run episodes (:doc:`guide <../controllers>`).",
        (
            "baselines.controller",
            "baselines.registry",
            "baselines.rollout",
            "baselines",
            "engine.exogenous.forecast",
            "engine.physics.connections",
            "engine.physics.acting_relays",
            "engine.physics.relay_slopes",
        ),
    ),
    Group(
        "Train a policy",
        "Train with Stable-Baselines3, load a policy and guard it (:doc:`guide <../training>`). The bundled "
        "algorithms are :doc:`commands <command-line>`.",
        ("agents.training", "agents.policy.policy", "agents"),
    ),
    Group(
        "Score and compare",
        "Evaluate controllers, compute scores and metrics, and record episodes (:doc:`definitions <../results>`).",
        (
            "agents.scoring",
            "baselines.evaluation",
            "baselines.score",
            "baselines.sanity",
            "baselines.hindsight_costs",
            "baselines.model_based.hindsight",
            "baselines.recorded_actions",
            "core.metric",
            "engine.cost",
            "engine.record",
        ),
    ),
    Group(
        "Own feeder",
        "Read, import or generate a feeder and make a scenario of it (:doc:`guide <../own-feeder>`).",
        (
            "grid.cases",
            "grid.folder",
            "scenario.on_feeder",
            "grid.feeder",
            "grid.three_phase",
            "grid",
            "apps.importers",
            "baselines.source_voltage",
        ),
    ),
    Group(
        "Power flow",
        "Solve the power flow and compute sensitivities and loadings (:doc:`equations <../model>`).",
        ("powerflow",),
    ),
    Group(
        "Own workload",
        "Read, record or generate the power of data centres over time (:doc:`guide <../traces>`).",
        (
            "traces.by_name",
            "traces.trace",
            "traces.logs",
            "traces.recorder",
            "traces.recorded_rows",
            "traces",
            "engine.exogenous.clock_starts",
            "engine.exogenous.profile_loads",
        ),
    ),
    Group(
        "Capacity",
        "Compute how much load each bus can host (:doc:`guide <../capacity>`).",
        ("apps.hosting.hosting", "apps.hosting"),
    ),
    Group(
        "Offline data",
        "Collect episodes for offline reinforcement learning (:doc:`guide <../offline-data>`).",
        ("baselines.offline_data",),
    ),
    Group(
        "Devices",
        "Describe data centres, inverters, storages and their features (:doc:`guide <../sites>`).",
        ("devices.datacenter.data_centers", "devices.inverter", "devices.storage", "devices"),
    ),
    Group(
        "Extend",
        "Register a kind of device. The :doc:`architecture <../architecture>` lists the places for other additions.",
        ("devices.device", "devices.registry", "powerflow.control"),
    ),
    Group("Draw", "Draw feeders and episodes, and write replays (:doc:`guide <../replay>`).", ("rendering",)),
)

INDEXED = {"dcgrid_env.envs.single": "make", "dcgrid_env.envs.vector": "make_vec"}
"""Functions of Gymnasium by the module that they use: main entries of the index, which the search lists first."""


def modules() -> dict[str, list[str]]:
    """Public names by the module that defines them, as users import them."""
    found: dict[str, list[str]] = {}
    for origin, public in sorted(public_by_origin().items()):
        found.setdefault(origin.rpartition(".")[0], []).append(public)
    return found


def place(module: str) -> tuple[Group, int]:
    """Return the group of a module and its place there; raise ValueError for a module that belongs to none."""
    fits = {name: (group, i) for group in GROUPS for i, name in enumerate(group.modules)}
    within = module.removeprefix("dcgrid_env.") + "."
    found = max((name for name in fits if within.startswith(f"{name}.")), key=len, default=None)
    if found is None:
        raise ValueError(f"module {module!r} belongs to no group; add it to GROUPS in docs/extensions/api_pages.py")
    return fits[found]


def document(module: str) -> str:
    """Name of a module's page."""
    return module.removeprefix("dcgrid_env.").replace("_", "-")


def summary(text: str | None) -> str:
    """First sentence of a docstring."""
    return re.split(r"(?<=\.)\s+(?=[A-Z`])", " ".join((text or "").split("\n\n")[0].split()))[0]


def described(module: str, public: str) -> str:
    """First sentence about a public name."""
    name = public.rpartition(".")[2]
    value = getattr(import_module(module), name)
    return summary(inspect.getdoc(value) if callable(value) else "\n".join(text_of_data(module, name)))


def page(module: str, names: list[str]) -> str:
    """The page of a module, as reStructuredText."""
    title, package, group = titled(names), names[0].rpartition(".")[0], place(module)[0].title
    rows = [(f":py:obj:`~{public}`", described(module, public)) for public in names]
    lines = [":orphan:", "", *heading(title, "="), summary(import_module(module).__doc__), ""]
    lines += [f".. index:: ! {INDEXED[module]}", ""] if module in INDEXED else []
    lines += [f"*Import from* ``{package}``. *Group:* :ref:`{group} <{label(group)}>`.", ""]
    lines += [*table(rows), f".. currentmodule:: {package}", ""]
    return "\n".join([*lines, *(line for public in names for line in entry(module, public))]) + "\n"


def titled(names: list[str]) -> str:
    """Public names in a row, without their package."""
    return ", ".join(public.rpartition(".")[2] for public in names)


def entry(module: str, public: str) -> list[str]:
    """The directive of one name, within its package."""
    name = public.rpartition(".")[2]
    value = getattr(import_module(module), name)
    if isinstance(value, type):
        return [f".. autoclass:: {public}", "   :members:", "   :show-inheritance:", ""]
    if inspect.isfunction(value):
        return [f".. autofunction:: {public}", ""]
    text = [f"   {line}" for line in text_of_data(module, name)]
    return [f".. py:data:: {name}", f"   :type: {type(value).__name__}", "", *text, ""]


def index() -> str:
    """The page that lists the modules by group."""
    lines = [
        *heading("API reference", "="),
        "Find a name by its task, in the :ref:`alphabetical index <genindex>`, or with the search. Other modules are "
        "internal and may change.",
        "",
        "Commands are on a separate page: :doc:`command-line`.",
        "",
        ".. toctree::",
        "   :hidden:",
        "",
        "   command-line",
        "",
    ]
    for group in GROUPS:
        within = [module for module in modules() if place(module)[0] == group]
        rows = [
            (
                ", ".join(f":py:obj:`~{public}`" for public in modules()[module]),
                summary(import_module(module).__doc__),
            )
            for module in sorted(within, key=lambda module: place(module)[1])
        ]
        lines += [f".. _{label(group.title)}:", "", *heading(group.title, "-"), group.about, "", *table(rows)]
    return "\n".join(lines)


def label(title: str) -> str:
    """Label of a group's heading."""
    return f"api-{title.lower().replace(' ', '-')}"


def heading(title: str, line: str) -> list[str]:
    """A heading and an empty line."""
    return [title, line * len(title), ""]


def table(rows: list[tuple[str, str]]) -> list[str]:
    """A table of names and what they are for."""
    lines = [".. list-table::", "   :widths: auto", ""]
    return [*lines, *(line for name, about in rows for line in (f"   * - {name}", f"     - {about}")), ""]


def tidy(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Leave out the text that named tuples have of themselves."""
    if lines and lines[0].startswith("Alias for field number"):
        lines[:] = []


def make(app: Sphinx) -> None:
    """Write the pages before the sources are read."""
    folder = Path(app.srcdir) / API
    folder.mkdir(exist_ok=True)
    pages = {document(module): page(module, names) for module, names in modules().items()} | {"index": index()}
    for path in folder.glob("*.rst"):
        if path.stem not in (*pages, "command-line"):
            path.unlink()  # of a module that has no public name any more
    for name, text in pages.items():
        path = folder / f"{name}.rst"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Make the pages when the builder is there."""
    app.connect("builder-inited", make)
    app.connect("autodoc-process-docstring", tidy)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
