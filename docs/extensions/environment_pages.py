"""A page for each preset, made from the registry of scenarios when the site is built."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from families import FAMILIES, Family, family_of
from headroom import best_policy, headroom, shown_controller
from sphinx.application import Sphinx
from sphinx.util import logging

from dcgrid_env import IDS, PRESETS, Scenario, field_names, make_scenario, scenario_hash
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from docs.studies.pictures.picture import STEPS, shown_scenario

FOLDER = "environments"
SUFFIX = ".myst"
"""Suffix of generated pages; the checks of ``.md`` files skip them."""
OBSERVED = {
    "v_deviation": "(V - 1) / band: 1 is the band's edge",
    "v_change": "change of V in the last step / band",
    "p": "draw, share of the rating; an injection is negative",
    "q": "dispatched reactive power, share of the limit at zero active power",
    "q_limit": "reactive limit now, the same share",
    "r": "drop of this voltage per MW drawn / band",
    "x": "drop of this voltage per Mvar drawn / band",
    "v_lowest": "lowest of its phases, as v_deviation",
    "v_highest": "highest of its phases, as v_deviation",
}
"""Meaning of the fields that every agent observes; devices define the meaning of the others."""
CHARGED = {
    "voltage": r"mean over buses of $\lvert V - 1 \rvert$",
    "violation": r"mean over buses of $\max(\lvert V - 1 \rvert - 0.05, 0)$",
    "backlog": "queued work of all sites, s at their rated power",
    "effort": "mean over agents of abs(q) as a share of the apparent-power rating",
    "leftover": "work left at the episode's end, s at the rated power; charged once, over T",
    "switching": "mean number of taps and switchings over the equipment",
    "ramp_excess": "mean over sites of what a ramp exceeds the utility's limit by",
    "voltage_step_excess": "mean over buses of what a step of the voltage exceeds the utility's limit by",
    "burnt": "power burnt to hold a floor or a ramp",
    "trips": "sites that leave the grid in the step",
    "away": "sites that are away",
    "recharge": "energy missing in the UPS at the episode's end",
    "inverter_trips": "inverters that trip in the step",
    "moving": "work moved between sites",
    "late": "work past its deadline",
    "missing_energy": "energy missing in storages at the episode's end",
}
"""What the cost terms charge, before their weights."""
LOG = logging.getLogger(__name__)


def page(preset: str) -> str:
    """The page of a preset, as MyST Markdown."""
    scenario = make_scenario(preset, split="test")
    gym_id = next(name for name, of in IDS.items() if of == preset)
    family = family_of(preset)
    picture, steps = f"pictures/{preset}.png", min(STEPS, scenario.horizon - 1)
    parts = [
        f"# {preset}",
        f"{sentence(PRESETS[preset])}.",
        animation(preset, scenario.horizon),
        f"![{preset} under the tuned droop: the voltages of the feeder and the episode's time series]({picture})",
        f"*`python -m docs.studies.pictures.picture {preset}.png {preset} droop-tuned`: "
        f"test split, seed 0, after {steps} steps.*",
        f"```python\nimport gymnasium, dcgrid_env\n\n"
        f'env = gymnasium.make("{gym_id}")  # one agent controls all devices\n'
        f'envs = gymnasium.make_vec("{gym_id}", num_envs=64)  # one vectorised environment\n'
        f'many = dcgrid_env.parallel_env("{preset}")  # PettingZoo: {scenario.n_agents} agents\n```',
        "## Problem",
        family.presets[preset],
        facts(scenario),
        "## Headroom",
        headroom_table(preset),
        "## Agents",
        agents(scenario),
        "## Actions",
        "An action has one number from -1 to 1 for each channel, in this order.",
        channels(scenario),
        "## Observations",
        "Each agent observes these fields of its bus, in this order. "
        "`observe=` adds fields of others ([spaces](../environments.md)).",
        fields(scenario),
        "## Cost",
        cost(scenario),
        "## See also",
        read_on(family, preset),
    ]
    return "\n\n".join(parts) + "\n"


def animation(preset: str, horizon: int) -> str:
    """The animation, its last frame for readers who prefer reduced motion, and a caption."""
    name, steps = shown_controller(preset), shown_scenario(preset).horizon
    about = f"An episode of {preset} without control and under {name}: voltages and power of data centres"
    pictures = [
        f":::{{image}} pictures/{preset}{end}\n:class: {look}\n:alt: {about}\n:::"
        for end, look in ((".gif", "moving"), ("-whole.png", "still"))
    ]
    part = "" if steps == horizon else f" Only the first {steps} of {horizon} steps are shown."
    caption = (
        f"*The same episode (test split, seed 0) without control (orange) and under `{name}` "
        "(blue). Above: the lowest voltage (thick) and the highest voltage (thin); the red areas are outside the "
        f"limits. Below: the total power of the data centres.{part} "
        f"`python -m docs.studies.pictures.animation {preset}.gif {preset} {name}` draws it.*"
    )
    return "\n\n".join([*pictures, caption])


def sentence(about: str) -> str:
    """A preset's line with a capital, unless it begins with the name of another preset."""
    return about if about.split()[0] in PRESETS else about[0].upper() + about[1:]


def facts(scenario: Scenario) -> str:
    """Feeder, time, load and hash, as a table."""
    feeder, sensing, trace = scenario.feeder, scenario.sensing, scenario.workload.trace
    kind = "three-phase" if isinstance(feeder, ThreePhaseFeeder) else "balanced"
    told = f"{feeder.name}, {kind}, {feeder.n_bus} buses"
    if isinstance(feeder, RandomFeeders):
        told = f"random feeders of {feeder.n_bus} buses"
    rows = [
        ("feeder", told),
        ("substation", f"{scenario.source_voltage_pu:g} p.u."),
        ("episode", f"{scenario.horizon} steps of {scenario.dt_s:g} s"),
        ("load of the sites", f"`{trace}`" if isinstance(trace, str) else "recorded"),
        ("noise of the other loads", f"{scenario.background.load_sigma:.0%}"),
        ("power flow", f"`{scenario.power_flow}`"),
        ("hash of the test split", f"`{scenario_hash(scenario)}`"),
    ]
    if scenario.faults:
        rows.insert(4, ("lost for a while", ", ".join(kind for fault in scenario.faults for kind in fault.among)))
    if scenario.sags:
        rows.insert(4, ("sags", f"{len(scenario.sags)} in an episode"))
    if sensing.noise_pu or sensing.delay_steps or not sensing.preview:
        preview = "with" if sensing.preview else "without"
        told = f"noise of {sensing.noise_pu:g} p.u., {sensing.delay_steps} steps late, {preview} preview"
        rows.insert(4, ("measured voltage", told))
    if source := source_of(feeder):
        rows.append(("source of the feeder", source))
    return table(("", ""), rows)


def source_of(feeder: Any) -> str:
    """Return the source of a bundled feeder; an empty string for a random one."""
    path = files("dcgrid_env.grid.data") / feeder.name / "feeder.toml"
    if not path.is_file():
        return ""
    facts = tomllib.loads(path.read_text(encoding="utf-8"))
    return " ".join(facts.get("source_of_facts", facts["source"]).split())


def headroom_table(preset: str) -> str:
    """Return the table of costs and scores of controllers on a preset."""
    found = headroom(preset)
    rows = [(row.what, row.meaning, row.j, row.saved, row.score) for row in found.rows]
    return (
        table(("controller", "what it is", "J", "J saved, %", "score (95 % interval)"), rows)
        + f"\n\nMeans over {found.episodes} test episodes. J is a cost, lower is better. J saved is "
        "relative to the tuned droop; the score is 0 for the tuned droop and 1 for hindsight "
        f"([definition](../results.md)). [The benchmark](../{found.page}.md) contains "
        "all controllers.\n\n"
        f"    dcgrid benchmark --scenarios {preset} --controllers all --out results/benchmark"
    )


def agents(scenario: Scenario) -> str:
    """Return the table of groups of agents: names, number, buses and sizes of their spaces."""
    rows, begin, names = [], 0, field_names(scenario)
    for device in scenario.devices:
        own = scenario.agents[begin : begin + device.count]
        begin += device.count
        buses = getattr(device, "buses", None)
        where = ", ".join(buses) if buses else "drawn in each episode"
        label = f"`{own[0]}`" if len(own) == 1 else f"`{own[0]}` .. `{own[-1]}`"
        rows.append((label, device.kind, where, f"({len(device.channels)},)", f"({len(names[own[0]])},)"))
    total = f"({sum(d.count * len(d.channels) for d in scenario.devices)},)"
    observed = f"({sum(map(len, names.values()))},)"
    rows.append(("all together", "`gymnasium.make`", "", total, observed))
    return table(("agents", "kind", "buses", "action", "observation"), rows)


def channels(scenario: Scenario) -> str:
    """Return the table of the channels of each kind of device."""
    rows = [
        (device.kind, f"`{channel.name}`", channel.unit, *map(span, (channel.lowest, channel.highest, channel.rest)))
        for device in scenario.devices
        for channel in device.channels
    ]
    return table(("kind", "channel", "unit", "at -1", "at 1", "inactive"), rows)


def span(values: np.ndarray) -> str:
    """Format the value that all slots share, or the lowest and the highest value."""
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:g}" if low == high else f"{low:g} .. {high:g}"


def fields(scenario: Scenario) -> str:
    """Observed fields: what every agent sees, then what each kind of device adds."""
    common = [name for name in next(iter(field_names(scenario).values())) if name in OBSERVED]
    rows = [("all", f"`{name}`", OBSERVED[name]) for name in common]
    for device in scenario.devices:
        own = device.fields(scenario.horizon, scenario.dt_s)
        rows += [(device.kind, f"`{field.name}`", field.unit) for field in own]
    return table(("who", "field", "unit"), rows)


def cost(scenario: Scenario) -> str:
    """The terms of the cost of a step and their weights."""
    weights = {name: weight for name, weight in scenario.cost.weights._asdict().items() if weight}
    for device in scenario.devices:
        for term in device.cost_terms(scenario.horizon, scenario.dt_s):
            if term.weight:
                weights[term.name] = term.weight
    rows = [
        (f"`cost_{name}`", f"{weight:g}", CHARGED.get(name, name.replace("_", " "))) for name, weight in weights.items()
    ]
    about = (
        "The cost of a step is the sum of these terms, each multiplied by its weight. J is the mean cost per step plus "
        "the charge for leftover work. [The model](../model.md#cost) has the formula."
    )
    return f"{about}\n\n" + table(("in `info`", "weight", "quantity"), rows)


def read_on(family: Family, preset: str) -> str:
    """Links to the family's other presets and to the pages that say more."""
    others = [f"[{name}]({name}{SUFFIX})" for name in family.presets if name != preset]
    pages = [f"[](../{name}.md)" for name in family.read_on]
    return "\n".join(f"- {link}" for link in (*pages, *others, "[](../training.md)"))


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A table of Markdown."""
    cells = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("\n", " ") for cell in row) + " |" for row in cells)


def gallery() -> str:
    """The page that lists all presets by family, with the headroom of each."""
    parts = [
        "# All environments",
        "Each preset is available as a Gymnasium id, a PettingZoo environment, a vectorised environment and a tensor "
        "environment. J is the mean cost of the test episodes, lower is better. The headroom is the share "
        "of the tuned droop's J that perfect foresight (hindsight) saves. The score is 0 for the tuned droop and 1 "
        "for hindsight.",
    ]
    for family in FAMILIES:
        rows: list[tuple[str, ...]] = []
        for preset in family.presets:
            found = {row.what.strip("`"): row for row in headroom(preset).rows}
            best = best_policy(preset)
            policy = None if best is None else found[best[0]]
            top = found.get("hindsight") or found["best known"]
            rows.append(
                (
                    f"[{preset}]({preset}{SUFFIX})",
                    PRESETS[preset],
                    found["none"].j,
                    found["droop-tuned"].j,
                    top.j,
                    top.saved,
                    policy.saved if policy else "–",
                    policy.score.split()[0] if policy else "–",
                )
            )
        head = (
            "preset", "what it is", "J: none", "J: droop-tuned", "J: hindsight", "headroom, %",
            "best policy: J saved, %", "its score",
        )  # fmt: skip
        parts += [f"## {family.title}", family.about, table(head, rows)]
        parts.append(":::{toctree}\n:hidden:\n\n" + "\n".join(family.presets) + "\n:::")
    return "\n\n".join(parts) + "\n"


def draw(docs: Path, folder: Path) -> None:
    """Draw the missing pictures and animations in a separate process."""
    missing = [name for name in PRESETS if not (folder / f"{name}.gif").exists()]
    if not missing:
        return
    folder.mkdir(parents=True, exist_ok=True)
    LOG.info("drawing %d pictures and animations of environments", len(missing))
    subprocess.run(
        [sys.executable, str(docs / "extensions" / "draw_environments.py"), str(folder), *missing], check=True
    )


def make(app: Sphinx) -> None:
    """Write the pages and pictures before the sources are read."""
    folder = Path(app.srcdir) / FOLDER
    draw(Path(app.srcdir), folder / "pictures")
    for name, text in {**{preset: page(preset) for preset in PRESETS}, "index": gallery()}.items():
        path = folder / f"{name}{SUFFIX}"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Make the pages when the builder is there."""
    app.connect("builder-inited", make)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
