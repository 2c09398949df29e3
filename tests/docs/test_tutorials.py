"""The tutorials: kept without outputs, every cell whole, every link right, and a picture in each.

The build of the site runs them (docs/conf.py).
"""

import ast
import json
import re

import pytest

from helpers.places import ROOT

FOLDER = ROOT / "docs" / "tutorials"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
NAMES = [path.stem for path in NOTEBOOKS]
LINK = re.compile(r"\]\(([^)#\s]+)")


def text_of(cell):
    return "".join(cell["source"])


def test_there_are_the_tutorials_that_the_gallery_shows():
    listed = re.findall(r"\]\(([\w-]+)\.ipynb\)", (FOLDER / "index.md").read_text(encoding="utf-8"))
    assert sorted(listed) == NAMES
    assert len(NAMES) == 7


@pytest.mark.parametrize("path", NOTEBOOKS, ids=NAMES)
def test_a_notebook_is_kept_without_outputs_and_every_cell_is_whole(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert (notebook["nbformat"], set(notebook["metadata"])) == (4, {"kernelspec", "language_info"})
    cells = notebook["cells"]
    assert cells[0]["cell_type"] == "markdown"
    assert text_of(cells[0]).startswith("# ")
    assert len({cell["id"] for cell in cells}) == len(cells)
    for cell in cells:
        assert text_of(cell).strip()
        assert cell["metadata"] == {}
        if cell["cell_type"] == "code":
            assert (cell["outputs"], cell["execution_count"]) == ([], None)
            ast.parse(text_of(cell))
        else:
            missing = [at for at in LINK.findall(text_of(cell)) if "://" not in at and not (FOLDER / at).exists()]
            assert missing == []
    assert any("plt.show()" in text_of(cell) for cell in cells if cell["cell_type"] == "code")


@pytest.mark.slow
def test_the_tutorial_of_ppo_runs_and_scores_its_policy(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("matplotlib.pyplot.show", lambda: None)
    cells = json.loads((FOLDER / "ppo-sb3.ipynb").read_text(encoding="utf-8"))["cells"]
    code = "\n\n".join(text_of(cell) for cell in cells if cell["cell_type"] == "code")
    exec(compile(code.replace("STEPS = 60_000", "STEPS = 10_000"), "ppo-sb3.ipynb", "exec"), {"__name__": "__main__"})
    score = float(re.findall(r"score (-?\d\.\d+)", capsys.readouterr().out)[0])
    assert score > 0.3
    assert (tmp_path / "my-ppo.safetensors").exists()
