"""What the site's pages are made of: every preset has a family and a headroom, and the README's table is what ships.

The site itself is built by .ci/run, where Sphinx is installed and a warning is an error.
"""

import json
import runpy
import subprocess
import sys

import pytest

from dcgrid_env import PRESETS, make_scenario
from dcgrid_env.agents.policy.policy import SHIPPED
from dcgrid_env.baselines.score import PUBLISHED_EPISODES
from docs.studies.publishing.benchmark_data import METRICS_SHOWN, all_data
from docs.studies.publishing.site_tables import NONE, sortable
from helpers.needs import has_policy
from helpers.places import ROOT

EXTENSIONS = ROOT / "docs" / "extensions"
PIXEL = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="


@pytest.fixture(autouse=True)
def _importable(monkeypatch):
    monkeypatch.syspath_prepend(str(EXTENSIONS))
    yield
    for name in ("families", "headroom"):
        sys.modules.pop(name, None)


def test_every_preset_stands_in_one_family():
    families = runpy.run_path(str(EXTENSIONS / "families.py"))
    presets = [preset for family in families["FAMILIES"] for preset in family.presets]
    assert sorted(presets) == sorted(PRESETS)
    assert families["family_of"]("routing").title == "Sites with more than a clock"
    with pytest.raises(ValueError, match=r"preset 'new' belongs to no family; add it to FAMILIES"):
        families["family_of"]("new")
    pages = {page for family in families["FAMILIES"] for page in family.read_on}
    assert [page for page in pages if not (ROOT / "docs" / f"{page}.md").is_file()] == []


@pytest.mark.slow
def test_headroom_is_that_of_the_benchmark_and_the_cards():
    headroom = runpy.run_path(str(EXTENSIONS / "headroom.py"))
    for preset in PRESETS:
        assert headroom["headroom"](preset).episodes >= PUBLISHED_EPISODES
        rows = {row.what.strip("`"): row for row in headroom["headroom"](preset).rows}
        best = rows.get("hindsight") or rows["best known"]
        droop, none = (float(rows[name].j) for name in ("droop-tuned", "none"))
        assert float(best.j) < droop < (1.01 if preset in ("ieee34-3ph", "ieee123-3ph-day") else 1.0) * none
        if (found := headroom["best_policy"](preset)) is None:
            assert not has_policy(preset)
            continue
        policy, scored = found
        assert scored.episodes >= PUBLISHED_EPISODES
        assert policy in SHIPPED
        assert scored.scenario == preset
        assert rows[policy].j == f"{scored.J:.4f}"
    weak = headroom["headroom"]("ieee33-weak")
    assert (weak.page, weak.episodes, weak.rows[2].what) == ("benchmark", 100, "`constant-q-tuned`")
    with pytest.raises(ValueError, match=r"no file of docs/benchmarks contains preset 'new'"):
        headroom["headroom"]("new")


@pytest.mark.slow
def test_every_page_of_an_environment_has_an_animation_of_its_best_policy():
    pytest.importorskip("sphinx")
    pages = runpy.run_path(str(EXTENSIONS / "environment_pages.py"))
    style = (ROOT / "docs" / "static" / "site.css").read_text(encoding="utf-8")
    for preset in PRESETS:
        text = pages["animation"](preset, make_scenario(preset).horizon)
        name = pages["shown_controller"](preset)
        assert (name == "droop-tuned") != has_policy(preset)
        assert f":::{{image}} pictures/{preset}.gif\n:class: moving\n" in text
        assert f":::{{image}} pictures/{preset}-whole.png\n:class: still\n" in text
        assert f"`python -m docs.studies.pictures.animation {preset}.gif {preset} {name}`" in text
        assert ("Only the first 150 of 1440 steps" in text) == (preset == "ieee123-3ph-day")
    assert "@media (prefers-reduced-motion: reduce) { img.moving { display: none; }" in style


@pytest.mark.parametrize("page", sorted(all_data()))
def test_every_figure_of_a_data_file_is_on_its_page(page):
    data = all_data()[page]
    assert f"(benchmarks/{page}.json)" in (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    text = runpy.run_path(str(EXTENSIONS / "benchmark_pages.py"))["tables"](data).replace("\u00a0", " ")
    results = text.partition("## All results")[2].partition(":::\n")[0]
    lines = {
        tuple(cell.strip("|` ") for cell in line.split(" | ")) for line in results.splitlines() if line[:2] == "| "
    }
    for row in data.rows:
        saved, means = row.saved_pct, row.means
        cells = (
            row.controller,
            *[row.scenario] * (len(data.scenarios) > 1),
            "{:.3f} ({:.3f} to {:.3f})".format(*(round(figure, 3) + 0.0 for figure in row.score)),
            "{:.1f} ({:.1f} to {:.1f})".format(*(round(figure, 1) + 0.0 for figure in saved)),
            f"{means['J']:.4f}",
            f"{means['interquartile_mean']:.4f}",
            *(metric.text(means[metric.name]) for metric in METRICS_SHOWN),
            row.observes,
        )
        assert cells in lines
    assert len(lines) == len(data.rows) + len(data.scenarios) + 1  # best costs, headings
    for preset, facts in data.scenarios.items():
        assert f"| [{preset}](environments/{preset}.myst) | {facts.episodes} |" in text
    for name in data.apply_to_none:
        assert f"`{name}`" in text
        assert not [row for row in data.rows if row.controller == name]
    assert f"\n\n    {data.command}\n" in text


def test_tables_are_sorted_by_a_script_that_needs_no_network():
    conf = runpy.run_path(str(ROOT / "docs" / "conf.py"))
    ((name, _),) = conf["html_js_files"]
    script = (ROOT / "docs" / "static" / name).read_text(encoding="utf-8")
    assert "table.sortable" in script
    assert "http" not in script
    rows = [("a", "-0.5 (-0.6 to 0.4)", "local"), ("b", NONE, "all")]
    assert sortable(("name", "score", "observes"), rows).splitlines() == [
        ":::{table}", ":class: sortable", "", "| name | score | observes |", "|---|---:|---|",
        "| a | -0.5 (-0.6 to 0.4) | local |", "| b | – | all |", ":::",
    ]  # fmt: skip


def test_the_readme_has_the_table_that_its_command_prints():
    headline = runpy.run_path(str(ROOT / "docs" / "studies" / "publishing" / "headline.py"))
    made = headline["table"]()
    assert made.count("\n") == 1 + len(headline["SHOWN"])
    assert made in (ROOT / "README.md").read_text(encoding="utf-8")
    assert headline["tasks"]() in (ROOT / "docs" / "tasks.md").read_text(encoding="utf-8")
    assert headline["results"]() in (ROOT / "docs" / "results.md").read_text(encoding="utf-8")


@pytest.fixture
def built(tmp_path):
    """Build a site of one notebook, which has run, with this output; return what the build says, and its folder."""
    pytest.importorskip("myst_nb")

    def build(output):
        source, out = tmp_path / "docs", tmp_path / "built" / "site"
        source.mkdir()
        cell = {"cell_type": "code", "execution_count": 1, "metadata": {}, "outputs": [output], "source": "1"}
        notebook = {
            "cells": [cell],
            "metadata": {"language_info": {"name": "python"}},
            "nbformat": 4,
            "nbformat_minor": 4,
        }
        (source / "index.ipynb").write_text(json.dumps(notebook), encoding="utf-8")
        conf = f"import sys\nsys.path.insert(0, {str(EXTENSIONS)!r})\nextensions = ['myst_nb', 'notebooks']\n"
        (source / "conf.py").write_text(f"{conf}nb_execution_mode = 'off'\n", encoding="utf-8")
        command = [sys.executable, "-m", "sphinx", "-W", "-q", source, out]
        return subprocess.run(command, capture_output=True, text=True), out

    return build


@pytest.mark.slow
def test_a_build_leaves_nothing_beside_the_site(built):
    done, out = built({"output_type": "display_data", "metadata": {}, "data": {"image/png": PIXEL}})
    assert done.returncode == 0, done.stderr
    assert [path.name for path in out.parent.iterdir()] == ["site"]
    assert list((out / "_images").glob("*.png"))


@pytest.mark.parametrize(
    ("text", "fails"), [("dcgrid: compiling kernels, once.\n", False), ("Warning: a number is odd\n", True)]
)
@pytest.mark.slow
def test_stderr_of_a_notebook_fails_the_build_unless_it_is_the_line_about_compiling(built, text, fails):
    done, out = built({"output_type": "stream", "name": "stderr", "text": text})
    assert (done.returncode != 0) is fails
    assert ("a cell writes to stderr: Warning: a number is odd" in done.stderr) is fails
    assert text.strip() not in (out / "index.html").read_text(encoding="utf-8")
