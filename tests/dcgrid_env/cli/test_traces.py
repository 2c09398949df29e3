"""`dcgrid traces`, as a user runs it."""

import json
import re

import pytest

from dcgrid_env.cli.main import main


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("DCGRID_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("COLUMNS", "200")
    return tmp_path / "cache"


def fails(capsys, *arguments):
    with pytest.raises(SystemExit) as stop:
        main(["traces", *arguments])
    assert stop.value.code == 2
    return capsys.readouterr().err


def test_show_draws_one_trace_over_another(tmp_path, capsys):
    out = tmp_path / "new" / "trace.png"
    main(["traces", "show", "training", "--against", "inference", "--duration-s", "60", "--out", str(out)])
    assert out.read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    assert "training: 60 s, generator training, seed 0" in printed
    assert "inference: 60 s" in printed


@pytest.mark.filterwarnings("error")
def test_show_refuses_what_is_too_short_for_the_picture(tmp_path, capsys):
    out, path = tmp_path / "new" / "trace.png", tmp_path / "site.csv"
    path.write_text("0,100\n5,200\n", encoding="utf-8")
    for arguments, message in (
        (
            ["chat", "--duration-s", "1"],
            "chat: must last at least 2 steps of --dt-s 1 .*got 1 s; .*longer trace .--duration-s 2.$",
        ),
        (
            ["chat", "--dt-s", "700"],
            r"chat: must last .*, got 600 s; .*--duration-s 1400. or shorter steps .--dt-s 300.$",
        ),
        (["chat", "--duration-s", "1", "--dt-s", "0.1"], "and 2 s for the spectrum, got 1 s; .*--duration-s 2.$"),
        (
            [str(path), "--dt-s", "3"],
            r"site\.csv: must last .*, got 5 s; use a longer recording or shorter steps .--dt-s 2.$",
        ),
        (["chat", "--against", str(path), "--dt-s", "3"], r"site\.csv: must last .*, got 5 s"),
        (["chat", "--dt-s", "-1"], "--dt-s = -1.0 is not a finite number above 0"),
    ):
        said = " ".join(fails(capsys, "show", *arguments, "--out", str(out)).split())
        assert re.search(message, said), said
        assert not out.parent.exists()
    for arguments in (["chat", "--duration-s", "2"], [str(path), "--dt-s", "2"]):
        main(["traces", "show", *arguments, "--out", str(out)])
        assert out.read_bytes().startswith(b"\x89PNG")
        out.unlink()


def test_show_names_what_there_is(capsys):
    assert "`dcgrid list traces` lists all; or give a file" in fails(capsys, "show", "nothing")
    assert "dcgrid traces fetch azure-2023-code" in fails(capsys, "show", "azure-2023-code")


def test_fetch_names_what_there_is_and_shows_the_licence(capsys, monkeypatch, tmp_path):
    assert "no recording 'nothing'; `dcgrid list traces` lists all" in fails(capsys, "fetch", "nothing")
    content = b"0,100\n1,200\n"
    monkeypatch.setattr("dcgrid_env.traces.recordings.fetch", lambda name, cache, progress: tmp_path / "there.csv")
    (tmp_path / "there.csv").write_bytes(content)
    main(["traces", "fetch", "azure-2023-code"])
    printed = capsys.readouterr().out
    assert "licence: CC-BY 4.0" in printed
    assert "Splitwise" in printed


def test_record_without_a_gpu_says_what_is_missing(capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pynvml", None)
    assert "pip install -e '.[record]'" in fails(capsys, "record", str(tmp_path / "gpus.csv"))
    assert not list(tmp_path.glob("gpus*"))


def test_run_takes_any_load_and_keeps_its_origin(tmp_path, capsys):
    path = tmp_path / "site.csv"
    path.write_text("".join(f"{s},{100 + s % 50}\n" for s in range(700)), encoding="utf-8")
    arguments = ["--episodes", "1", "--controllers", "none", "--out", str(tmp_path)]
    main(["run", "--trace", str(path), *arguments])
    meta = json.loads((tmp_path / "results.json").read_text())["meta"]
    assert [origin["name"] for origin in meta["trace"]] == ["site.csv"]
    assert len(meta["trace"][0]["sha256"]) == 64
    capsys.readouterr()
    main(["run", "--trace", "deepseek-v3", "--dvfs", "prefill-decode", "--split", "ood", *arguments])
    results = json.loads((tmp_path / "results.json").read_text())
    origin = results["meta"]["trace"]
    assert [row["seed"] for row in origin] == [3_000_000 + i for i in range(24)]
    assert origin[0]["parameters"]["site"]["gpu"] == "H200"
    assert results["episodes"][0]["requests_sampled"] > 0
    assert "time to first token, 99 %" in capsys.readouterr().out
