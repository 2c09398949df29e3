"""Statements about the paper match its source."""

import re

import pytest

from dcgrid_env.apps.reproduction.paper import BUSES_INSIDE_PCT, FIVE_SITES_PU, GAIN_PCT, TABLE_ONE
from helpers.places import PAPER_SOURCE, ROOT, needs_paper_source

NUMBERED = {"eqn:p_f": 4, "eqn:u_p": 5, "eqn:S": 6, "eqn:u_Q": 7}
"""Equations of the law, by their labels in the source."""

pytestmark = needs_paper_source


@pytest.fixture(scope="module")
def source():
    return PAPER_SOURCE.read_text(encoding="utf-8")


def test_table_one_has_the_numbers_of_the_source(source):
    rows = re.findall(r"^(\d) &(.*?)\\\\", source, re.MULTILINE)
    found = {}
    for n, cells in rows:
        numbers = [float(number) for number in re.findall(r"\d+\.\d+", cells)]
        for i, k_p in enumerate((1.0, 10.0, 20.0)):
            found[int(n), k_p] = tuple(numbers[3 * i : 3 * i + 3])
    assert found == TABLE_ONE
    text = " ".join(source.split())
    assert f"deviation of ${FIVE_SITES_PU[0]}$, while with only inverter control, such deviation can reach " in text
    assert f"${FIVE_SITES_PU[1]}$" in text
    assert f"more than ${GAIN_PCT}\\%$ gain" in text
    assert f"More than ${BUSES_INSIDE_PCT:g}\\%$ of the buses" in text


def test_equations_are_cited_by_the_numbers_of_the_source(source):
    labels = re.findall(
        r"\\begin\{(?:equation|subequations)\}(?:(?!\\end\{(?:equation|subequations)\}).)*?\\label\{(.*?)\}",
        source,
        re.DOTALL,
    )
    number = {label: i for i, label in enumerate(labels, start=1)}
    assert {label: number[label] for label in NUMBERED} == NUMBERED
    law = (ROOT / "baselines" / "laws" / "droop.py").read_text(encoding="utf-8")
    model = (ROOT / "docs" / "model.md").read_text(encoding="utf-8")
    assert f"equation ({number['eqn:u_p']}) for P and ({number['eqn:u_Q']}) for Q" in law
    assert f"equation ({number['eqn:S']}) as printed" in law
    assert (
        f"{{eq}}`droop-p`, {{eq}}`droop-q` | the paper's eqs. ({number['eqn:u_p']}) and ({number['eqn:u_Q']})" in model
    )
    assert f"backlog $S$ | eq. ({number['eqn:S']}) prints one step" in model
    assert f"{{eq}}`ceiling` | the paper's eq. ({number['eqn:p_f']})" in model
    assert not re.search(r"eqs?\. [78]\b|Equations? [78]\b", law + model)
