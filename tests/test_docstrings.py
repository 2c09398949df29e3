"""Public docstrings and help texts are sentences that stand alone; a file's bare name stands for one idea."""

import ast
import re
from collections import defaultdict
from itertools import pairwise

import pytest

from helpers.places import ROOT

FOLDERS = ("dcgrid_env", "baselines", "agents", "traces", "apps", "docs/studies")
NO_SENTENCE = re.compile(r"(?:Of|The same|As)\b")
"""How a text begins that cannot be read without the one before it."""
IN_EVERY_PACKAGE = ("__init__", "__main__")
ONE_IDEA = {
    "model_aided": {"baselines/model_aided/model_aided.py", "docs/studies/laws/model_aided.py"},
    "registry": {"baselines/registry.py", "dcgrid_env/devices/registry.py"},
}
"""Files of one bare name that share one idea: a command bears the name of what it runs, a registry finds by name."""


def paths():
    return sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))


def public(name):
    return not name.startswith("_") or (name.startswith("__") and name.endswith("__"))


def texts(path):
    """Line and text of each docstring of what is public, of a class's fields and a module's constants too."""

    def within(node):
        body = node.body
        for k, child in enumerate(body):
            text = child.value.value if isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant) else None
            if isinstance(text, str):
                owner = body[k - 1] if k else None
                target = owner.targets[0] if isinstance(owner, ast.Assign) else getattr(owner, "target", None)
                if not isinstance(target, ast.Name) or public(target.id):
                    yield child.lineno, text
            elif isinstance(child, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)) and public(child.name):
                yield from within(child)

    yield from within(ast.parse(path.read_text()))


def openings(text):
    """How a docstring begins, and the description of each parameter, attribute or result that it lists."""
    lines = [line for line in text.splitlines() if line.strip()]
    yield text.strip()
    for above, line in pairwise(lines):
        if len(line) - len(line.lstrip()) > len(above) - len(above.lstrip()) and above is not lines[0]:
            yield line.strip()


@pytest.mark.slow
def test_public_docstrings_stand_alone():
    begins = [(path, line, opening) for path in paths() for line, text in texts(path) for opening in openings(text)]
    bad = [f"{path.relative_to(ROOT)}:{line}: {text[:60]}" for path, line, text in begins if NO_SENTENCE.match(text)]
    assert not bad, "\n" + "\n".join(bad)


def test_what_the_rule_refuses_and_what_it_lets_pass(tmp_path):
    path = tmp_path / "module.py"
    a_class = 'class E:\n    """Often."""\n    f: int = 1\n    """As g."""\n'
    path.write_text('A = 1\n"""Of b."""\n_C = 1\n"""Of d."""\n' + a_class)
    assert list(texts(path)) == [(2, "Of b."), (6, "Often."), (8, "As g.")]
    assert [bool(NO_SENTENCE.match(text)) for _, text in texts(path)] == [True, False, True]
    numpydoc = (
        "Do it.\n\n    Parameters\n    ----------\n    a, b\n        Of c.\n    d\n        Number\n        of e.\n    "
    )
    assert list(openings(numpydoc))[1:] == ["Of c.", "Number"]


def test_a_bare_file_name_stands_for_one_idea():
    places = defaultdict(set)
    for path in paths():
        places[path.stem].add(path.relative_to(ROOT).as_posix())
    shared = {name: files for name, files in places.items() if len(files) > 1 and name not in IN_EVERY_PACKAGE}
    assert {name: files for name, files in shared.items() if files != ONE_IDEA.get(name)} == {}
    assert set(ONE_IDEA) <= set(shared)
