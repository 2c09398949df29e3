"""``dcgrid import gridlabd`` in a terminal: a folder, a table and a comparison, or one line and nothing written."""

import pytest

from dcgrid_env import ThreePhaseFeeder
from dcgrid_env.cli.main import main
from helpers.gridlabd_text import HEAD, SPLIT_PHASE

pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")


@pytest.fixture
def model(tmp_path):
    (tmp_path / "secondaries.glm").write_text(SPLIT_PHASE)
    path = tmp_path / "model.glm"
    path.write_text(f'{HEAD}#include "secondaries.glm"\n')
    return path


def said(capsys, *words):
    """Output of a command that fails with one line."""
    with pytest.raises(SystemExit) as ended:
        main(["import", "gridlabd", *map(str, words)])
    err = capsys.readouterr().err
    assert ended.value.code == 2
    assert err.startswith("dcgrid: ")
    assert err.count("\n") == 1
    return err


@pytest.mark.slow
def test_a_feeder_is_written_and_compared(model, capsys):
    out = model.parent / "my-feeder"
    main(["import", "gridlabd", str(model), "--out", str(out)])
    text = capsys.readouterr().out
    assert "largest voltage difference from OpenDSS" in text
    assert "differ by more than" not in text
    assert f"wrote {out}: 4 buses, 10 nodes, 0 regulators" in text
    assert set(ThreePhaseFeeder.from_csv(out).node_ids) >= {"tm.a", "tm.b", "n1.c"}


def test_errors_are_one_line_and_leave_nothing(model, capsys):
    out = model.parent / "out"
    assert "there is no file" in said(capsys, model.parent / "none.glm", "--out", out)
    assert "'tree' is no kind of loss" in said(capsys, model, "--out", out, "--allow", "tree")
    inner = model.parent / "inner"
    assert "give one that has it" in said(capsys, model, "--out", out, "--root", inner)
    model.write_text(f"{HEAD}\nobject fuse {{ name f; phases A; from src; to n1; }}")
    assert "fuse f: it never blows; --allow fuse accepts that" in said(capsys, model, "--out", out)
    model.write_text(f"{HEAD}\n#system ls")
    assert "#system is refused" in said(capsys, model, "--out", out)
    assert not out.exists()
