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


@pytest.mark.slow
def test_show_draws_one_trace_over_another(tmp_path, capsys):
    out = tmp_path / "new" / "trace.png"
    main(["traces", "show", "training", "--against", "inference", "--duration-s", "60", "--out", str(out)])
    assert out.read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    assert "training: 60 s, generator training, seed 0" in printed
    assert "inference: 60 s" in printed


@pytest.mark.filterwarnings("error")
@pytest.mark.slow
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
        (["chat", "--dt-s", "-1"], "dt_s: must be at least 0.001, got -1"),
    ):
        said = " ".join(fails(capsys, "show", *arguments, "--out", str(out)).split())
        assert re.search(message, said), said
        assert not out.parent.exists()
    for arguments in (["chat", "--duration-s", "2"], [str(path), "--dt-s", "2"]):
        main(["traces", "show", *arguments, "--out", str(out)])
        assert out.read_bytes().startswith(b"\x89PNG")
        out.unlink()


@pytest.mark.slow
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


@pytest.mark.slow
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


ROWS = "".join(f"{s},{100 + s % 50}\n" for s in range(1000))


@pytest.mark.slow
def test_check_reports_a_recording_and_writes_the_files(tmp_path, capsys):
    (tmp_path / "site.csv").write_text("time_s,site_kw\n" + ROWS, encoding="utf-8")
    files = {option: tmp_path / name for option, name in (("png", "s.png"), ("out", "s.json"), ("save", "s.csv"))}
    words = [word for option, path in files.items() for word in (f"--{option}", str(path))]
    main(["traces", "check", str(tmp_path / "site.csv"), "--rated-kw", "200", *words])
    printed = " ".join(capsys.readouterr().out.split())
    for text in (
        "read: CSV with numeric times; column 0 ('time_s') in s, column 1 ('site_kw') in kW",
        "sampling: every 1 s, jitter 0.000 s (95 %)",
        "rating: 200 kW",
        "idle 102 kW (51.0%), mean 124.5 kW (62.2%), peak 149 kW (74.5%); shares of the rating",
        "windows of 122 s: train 4, validation 1, test 1",
        "warning: few independent windows in train, validation, test",
        "its rating of 200 kW becomes the sites' rating of 1000 kW (times 5)",
    ):
        assert text in printed, text
    assert files["png"].read_bytes().startswith(b"\x89PNG")
    found = json.loads(files["out"].read_text())
    assert (found["rated_kw"], found["windows"]["train"], found["refused"]) == (200.0, 4, None)
    main(["traces", "check", str(files["save"]), "--horizon", "8"])
    printed = capsys.readouterr().out
    assert "rating: 200 kW" in printed
    assert "windows of 10 s: train 59, validation 20, test 20" in printed


def test_check_counts_the_samples_that_it_drops(tmp_path, capsys):
    (tmp_path / "site.csv").write_text(
        "time_s,site_kw\n" + ROWS + "1000,NaN\n1001,\n1002,-5\n1003,1\n", encoding="utf-8"
    )
    main(["traces", "check", str(tmp_path / "site.csv"), "--invalid", "drop"])
    printed = " ".join(capsys.readouterr().out.split())
    assert "in kW; 2 samples dropped (not a number); 1 samples dropped (negative)" in printed
    assert "gaps of more than 3 intervals: 1, the longest 4 s" in printed


def test_check_with_power_as_recorded(tmp_path, capsys):
    (tmp_path / "site.csv").write_text("time_s,site_kw\n" + ROWS, encoding="utf-8")
    words = ["check", str(tmp_path / "site.csv"), "--scenario", "toy6", "--out", str(tmp_path / "s.json")]
    scale = ["--set", "workload.trace_scale=as-recorded"]
    main(["traces", *words, *scale])
    assert "as recorded (highest power 149 kW) at sites of 2500 kW" in capsys.readouterr().out
    said = " ".join(fails(capsys, *words, *scale, "datacenters.p_rated_kw=120").split())
    assert "rises to 149 kW, above the rating of a site, 120 kW; raise datacenters.p_rated_kw" in said
    assert "rises to 149 kW" in json.loads((tmp_path / "s.json").read_text())["refused"]


@pytest.mark.parametrize(
    ("content", "options", "message"),
    [
        ("time_s,kw\n0,1\n1,NaN\n", [], r"site.csv, line 3: column 1 \('kw'\) is nan; remove or repair the sample"),
        ("time_s,kw\n0,1\n1,2\n", ["--step-s", "1"], "numeric times has no option --step-s; it has --unit, --power-"),
        ("time_s,kw\n0,1\n1,2\n", ["--png", "x.png"], "lasts 1 s but 2 s are needed"),
        ("time_s,kw\n0,1\n2,2\n", ["--rated-kw", "-1"], "rated_kw: must be at least 1e-06, got -1"),
        ("time_s,kw\n0,1\n1,2\n", ["--out", "."], "out: must be a file, got the folder '.'"),
    ],
)
def test_check_names_what_is_wrong_on_one_line(tmp_path, capsys, content, options, message):
    (tmp_path / "site.csv").write_text(content, encoding="utf-8")
    said = fails(capsys, "check", str(tmp_path / "site.csv"), *options)
    assert len(said.splitlines()) == 1
    assert re.search(message, said), said


def test_check_takes_options_for_files_alone(capsys):
    said = fails(capsys, "check", "azure-2023-code", "--unit", "kW")
    assert "unit: is an option for files, got the recording 'azure-2023-code'; leave it out" in said
    assert "no trace 'nothing'; `dcgrid list traces` lists all; or give a file" in fails(capsys, "check", "nothing")
