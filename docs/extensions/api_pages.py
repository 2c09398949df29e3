"""The API reference: a page for each part of the public interface, made from ``__all__`` when the site is built."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from public_names import origins, text_of_data
from sphinx.application import Sphinx

FOLDER = "api"


class Part(NamedTuple):
    """A page of the reference."""

    name: str
    title: str
    package: str
    rooms: tuple[str, ...]
    """Prefixes of the modules whose public names are on the page."""
    about: str


PARTS = (
    Part("environments", "Environments", "dcgrid_env", ("dcgrid_env.envs",), "What an agent steps."),
    Part(
        "scenarios",
        "Scenarios and their parts",
        "dcgrid_env",
        ("dcgrid_env.scenario",),
        "What is fixed before an episode is drawn.",
    ),
    Part(
        "devices",
        "Devices",
        "dcgrid_env",
        ("dcgrid_env.devices",),
        "Sites, inverters, storages and their parts.",
    ),
    Part(
        "episodes",
        "Episodes, metrics, forecasts",
        "dcgrid_env",
        ("dcgrid_env.engine", "dcgrid_env.core.metric"),
        "What happens in an episode, what is measured of it, what is known ahead.",
    ),
    Part("feeders", "Feeders", "dcgrid_env", ("dcgrid_env.grid",), "Networks, those that ship, those that are drawn."),
    Part(
        "power-flow",
        "Power flow",
        "dcgrid_env",
        ("dcgrid_env.powerflow",),
        "Solvers, solutions and sensitivities, for arrays and tensors alike.",
    ),
    Part(
        "baselines",
        "Controllers made by hand",
        "dcgrid_env.baselines",
        ("",),
        "Laws, model predictive control, rollouts and published costs.",
    ),
    Part("agents", "Learned policies", "dcgrid_env.agents", ("",), "Policies, their cards, their evaluation."),
    Part("traces", "Workloads", "dcgrid_env.traces", ("",), "Recordings and generators of power over time."),
    Part("rendering", "Drawing", "dcgrid_env.rendering", ("",), "Pictures of feeders and episodes."),
)


def names_of(part: Part) -> dict[str, str]:
    """Public names of a part and the modules that define them."""
    return {name: origin for name, origin in origins(part.package).items() if origin.startswith(part.rooms)}


def page(part: Part) -> str:
    """The page of a part, as reStructuredText."""
    names = names_of(part)
    lines = [part.title, "=" * len(part.title), "", part.about, "", f".. currentmodule:: {part.package}", ""]
    documented = [name for name in names if _has_docstring(part.package, name)]
    lines += [".. autosummary::", "", *(f"   {name}" for name in documented), ""]
    for name, origin in names.items():
        lines += entry(part.package, name, origin)
    return "\n".join(lines) + "\n"


def _has_docstring(package: str, name: str) -> bool:
    value = getattr(import_module(package), name)
    return isinstance(value, type) or callable(value)


def entry(package: str, name: str, origin: str) -> list[str]:
    """The directives of one name."""
    value = getattr(import_module(package), name)
    full = f"{package}.{name}"
    if isinstance(value, type):
        return [f".. autoclass:: {full}", "   :members:", "   :show-inheritance:", ""]
    if callable(value) and hasattr(value, "__module__"):
        return [f".. autofunction:: {full}", ""]
    text = [f"   {line}" for line in text_of_data(origin, name)]
    return [f".. py:data:: {full}", f"   :type: {type(value).__name__}", "", *text, ""]


def index() -> str:
    """The page that lists the parts."""
    lines = ["API reference", "=" * len("API reference"), ""]
    lines += ["Made from the docstrings of what is public; what stands in no ``__all__`` may change.", ""]
    lines += [".. toctree::", "", *(f"   {part.name}" for part in PARTS), "   command-line", ""]
    return "\n".join(lines)


def tidy(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Leave out the text that named tuples have of themselves."""
    if lines and lines[0].startswith("Alias for field number"):
        lines[:] = []


def make(app: Sphinx) -> None:
    """Write the pages before the sources are read."""
    folder = Path(app.srcdir) / FOLDER
    folder.mkdir(exist_ok=True)
    left_out = set(origins("dcgrid_env")) - {name for part in PARTS for name in names_of(part)}
    if left_out:
        raise ValueError(f"{', '.join(sorted(left_out))} stand on no page; add their room to PARTS in {__file__}")
    for name, text in {**{part.name: page(part) for part in PARTS}, "index": index()}.items():
        path = folder / f"{name}.rst"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Make the pages when the builder is there."""
    app.connect("builder-inited", make)
    app.connect("autodoc-process-docstring", tidy)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
