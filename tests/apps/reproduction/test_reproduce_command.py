"""``dcgrid reproduce``, as a user runs it."""

import json
import math
import re

import pytest

from dcgrid_env.apps.reproduction.markdown import render
from dcgrid_env.apps.reproduction.paper import TABLE_ONE
from dcgrid_env.apps.reproduction.verdict import VERDICTS
from dcgrid_env.cli.main import main


@pytest.mark.slow
def test_the_study_is_run_and_written_down(tmp_path, capsys):
    main(["reproduce", "--out", str(tmp_path), "--episodes", "2", "--trace", "generated"])
    assert "inverters only" in capsys.readouterr().out
    records = json.loads((tmp_path / "reproduction.json").read_text(encoding="utf-8"))
    text = (tmp_path / "reproduction.md").read_text(encoding="utf-8")
    assert records["setting"]["load"] == "generated"
    assert records["meta"]["trace"]["name"] == "generator inference"
    found = numbers(records)
    assert len(found) > 400
    assert all(math.isfinite(number) for number in found)
    check_claims(records["claims"])
    check_markdown(text, records)
    assert {path.name for path in tmp_path.iterdir()} == {"reproduction.json", "reproduction.md"}


def numbers(value):
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return [number for item in value for number in numbers(item)]
    return [value] if isinstance(value, float) else []


def check_claims(claims):
    assert len(claims) == 15
    for row in claims:
        assert all(row[key].strip() for key in ("claim", "paper", "ours", "verdict", "reason"))
        assert row["verdict"] in VERDICTS
        assert re.search(r"\d", row["ours"]), row["claim"]
        assert not set("|\n") & set("".join(row.values()))  # they would break the table
    paper = " ".join(row["paper"] for row in claims)
    for figure in ("0.03", "0.024 against 0.034", "12.8 %", "97 %"):
        assert figure in paper
    verdicts = {row["claim"]: row["verdict"] for row in claims}
    assert verdicts["delay rises with k_p"] == "holds"


def check_markdown(text, records):
    assert text == render(records)
    pair, delays = r" (\S+) ± (\S+) \|", r" (\S+) \| (\S+) \| (\S+) \|$"
    cell = r"^\| (\d) \| (\d+) \|" + 3 * pair + delays
    numbers = {(int(m[1]), float(m[2])): [float(x) for x in m.groups()[2:]] for m in re.finditer(cell, text, re.M)}
    assert {cell: (row[0], row[1], row[6]) for cell, row in numbers.items()} == TABLE_ONE
    for r in records["table_one"]:
        if r["memory"] == "cumulative":
            _, _, mean, std, _, _, _, delay, _ = numbers[r["n_datacenters"], r["k_p_mw_per_pu"]]
            assert mean == pytest.approx(r["deviation_mean_pu"], abs=5.1e-5)
            assert std == pytest.approx(r["deviation_std_pu"], abs=5.1e-5)
            assert delay == pytest.approx(r["delay_mean_s"], abs=5.1e-3)
    for row in records["claims"]:
        assert f"| {row['claim']} | {row['paper']} | {row['ours']} | {row['verdict']} | {row['reason']} |" in text


def test_an_interruption_is_one_line(tmp_path, capsys, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("dcgrid_env.apps.reproduction.study.study", interrupted)
    with pytest.raises(SystemExit) as stopped:
        main(["reproduce", "--out", str(tmp_path), "--trace", "generated"])
    assert stopped.value.code == 130
    # Nothing of the study is kept, so nothing is said of going on.
    assert capsys.readouterr().err.splitlines() == ["dcgrid: interrupted"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--episodes", "1"], "episodes is 1; give at least 2"),
        (["--trace", "no-such-trace"], "no trace 'no-such-trace'; "),
        (["--trace", "recorded"], "get it with `dcgrid traces fetch chen-zhang-2025-inference`"),
        (["--trace", "{short}"], "but 122 s are needed"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(arguments, message, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("DCGRID_CACHE", str(tmp_path / "cache"))
    short = tmp_path / "short.csv"
    short.write_text("".join(f"{t},{1 + t % 2}\n" for t in range(30)), encoding="utf-8")
    out = tmp_path / "out"
    with pytest.raises(SystemExit) as stopped:
        main(["reproduce", "--out", str(out), *(a.format(short=short) for a in arguments)])
    assert stopped.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith("dcgrid: ")
    assert message in error
    assert len(error.strip().splitlines()) == 1
    assert not out.exists()
