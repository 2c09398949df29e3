"""What docs/long-episodes.md measures with: it runs, and both ways come to the same cost."""

import re

import pytest

from docs.studies.speed.long_episodes import main


def test_both_ways_come_to_the_same_cost(capsys):
    pytest.importorskip("pyarrow")
    for how in ("whole", "parts"):
        main(30, 2, how)
    whole, parts = (
        float(re.findall(r"J of the first ([\d.e-]+)", line)[0]) for line in capsys.readouterr().out.splitlines()
    )
    assert parts == pytest.approx(whole, rel=1e-12)
