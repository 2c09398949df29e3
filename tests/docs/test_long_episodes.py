"""What docs/long-episodes.md measures with: it runs, and both ways come to the same cost."""

import re
import runpy

import pytest

from helpers.places import ROOT


def test_both_ways_come_to_the_same_cost(capsys):
    pytest.importorskip("pyarrow")
    main = runpy.run_path(str(ROOT / "docs" / "long_episodes.py"))["main"]
    for how in ("whole", "parts"):
        main(30, 2, how)
    whole, parts = (
        float(re.findall(r"J of the first ([\d.e-]+)", line)[0]) for line in capsys.readouterr().out.splitlines()
    )
    assert parts == pytest.approx(whole, rel=1e-12)
