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

PACKAGES = ("dcgrid_env", "dcgrid_env.baselines", "dcgrid_env.agents", "dcgrid_env.traces", "dcgrid_env.rendering")
API = "api/"
"""Folder of the API's pages, on which a type of an annotation that is not public is plain text."""


@cache
def origins(package: str) -> dict[str, str]:
    """The module that defines each public name of a package, by name."""
    module = import_module(package)
    return {name: defined_in(module, name) for name in module.__all__ if not name.startswith("__")}


def defined_in(module: ModuleType, name: str) -> str:
    """Name of the module that defines what a module imports under a name."""
    for node in ast.walk(ast.parse(inspect.getsource(module))):
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                if (alias.asname or alias.name) == name:
                    return defined_in(import_module(node.module), alias.name)
    return module.__name__


def text_of_data(origin: str, name: str) -> list[str]:
    """Lines of the docstring below a module's constant, none where it has none."""
    return ModuleAnalyzer.for_module(origin).find_attr_docs().get(("", name), [])


@cache
def public_by_origin() -> dict[str, str]:
    """The name that users import by the full name where something is defined."""
    found: dict[str, str] = {}
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
