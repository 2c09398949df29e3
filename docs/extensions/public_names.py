"""Where the public names of a package come from, and links to them by the name that users import."""

from __future__ import annotations

import ast
import inspect
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer

PACKAGES = (
    "dcgrid_env",
    "dcgrid_env.baselines",
    "dcgrid_env.agents",
    "dcgrid_env.traces",
    "dcgrid_env.rendering",
    "dcgrid_env.apps.importers.gridlabd",
    "dcgrid_env.apps.importers.matpower",
    "dcgrid_env.apps.importers.opendss",
    "dcgrid_env.apps.importers.pandapower",
    "dcgrid_env.apps.importers.power_grid_model",
)
FROM_THEIR_MODULE: tuple[str, ...] = (
    "dcgrid_env.agents.policy.law_interface.FEATURES",
    "dcgrid_env.agents.policy.law_interface.OUTPUTS",
    "dcgrid_env.agents.scoring.PolicyScore",
    "dcgrid_env.apps.hosting.capacity_study.Study",
    "dcgrid_env.apps.hosting.hosting.Capacities",
    "dcgrid_env.apps.hosting.hosting.hosting_capacity",
    "dcgrid_env.baselines.model_based.hindsight.Hindsight",
    "dcgrid_env.baselines.model_based.hindsight.hindsight",
    "dcgrid_env.baselines.offline_data.joint_episodes.JointEpisode",
    "dcgrid_env.baselines.offline_data.joint_episodes.joint_episodes",
    "dcgrid_env.baselines.recorded_actions.replayed",
    "dcgrid_env.baselines.sanity.scenario_check.ScenarioCheck",
    "dcgrid_env.baselines.sanity.scenario_check.check_scenario",
    "dcgrid_env.baselines.score.Score",
    "dcgrid_env.baselines.score.saved_pct",
    "dcgrid_env.baselines.score.score",
)
"""Public names that users import from their module, as the guides do, because no package has them."""
API = "api/"
"""Folder of the API's pages, on which a type of an annotation that is not public is plain text."""


@cache
def origins(package: str) -> dict[str, str]:
    """The module that defines each public name of a package, by name."""
    module = import_module(package)
    return {name: defined_in(module, name) for name in module.__all__ if not name.startswith("__")}


def defined_in(module: ModuleType, name: str) -> str:
    """Name of the module that defines what a module imports under a name, or gives by ``__getattr__``."""
    for node in ast.walk(ast.parse(inspect.getsource(module))):
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                if (alias.asname or alias.name) == name:
                    return defined_in(import_module(node.module), alias.name)
    return module.__name__ if name in vars(module) else getattr(module, name).__module__


def text_of_data(origin: str, name: str) -> list[str]:
    """Lines of the docstring below a module's constant, none where it has none."""
    return ModuleAnalyzer.for_module(origin).find_attr_docs().get(("", name), [])


@cache
def public_by_origin() -> dict[str, str]:
    """The name that users import by the full name where something is defined."""
    found: dict[str, str] = {name: name for name in FROM_THEIR_MODULE}
    for package in reversed(PACKAGES):  # a name that two packages give out is the first one's
        found |= {f"{origin}.{name}": f"{package}.{name}" for name, origin in origins(package).items()}
    return found


def resolve(app: Sphinx, env: Any, node: Any, contnode: nodes.Element) -> nodes.Element | None:
    """Link an annotation to the public name of what it names, else leave its text on the API's pages."""
    if node.get("refdomain") != "py":
        return None
    target, docname = node["reftarget"], node.get("refdoc", "")
    public = public_by_origin().get(target) or next(
        (f"{package}.{target}" for package in PACKAGES if target in origins(package)), None
    )
    if public and public != target:
        domain = env.get_domain("py")
        found = domain.resolve_xref(env, docname, app.builder, node["reftype"], public, node, contnode)
        if found is not None:
            return found
    return contnode if docname.startswith(API) else None


def setup(app: Sphinx) -> dict[str, Any]:
    """Resolve what the Python domain does not know by itself."""
    app.connect("missing-reference", resolve)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
