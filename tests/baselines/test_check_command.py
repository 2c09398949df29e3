"""``dcgrid check`` as a user runs it."""

import pytest

from dcgrid_env.cli.main import main


@pytest.mark.slow
def test_a_scenario_file_is_looked_at_and_judged(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    (tmp_path / "mine.toml").write_text('base = "toy6"\nhorizon = 20\n', encoding="utf-8")
    main(
        [
            "check",
            "mine.toml",
            "--episodes",
            "2",
            "--seconds",
            "2",
            "--workers",
            "1",
            "--set",
            "background.load_sigma=0.01",
        ]
    )
    said = capsys.readouterr().out
    assert "mine, validation split, found in" in said
    for name in ("no control", "paper's droop", "best droop", "best constant", "hindsight"):
        assert name in said
    verdicts = [line for line in said.splitlines() if line.startswith("- ")]
    assert any("stable up to k_q = " in line for line in verdicts)
    assert verdicts[-1].startswith("- mine is ")
    assert list(tmp_path.iterdir()) == [tmp_path / "mine.toml"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nothing.toml"], "nothing.toml is no file; give a scenario file"),
        (["toy6", "--episodes", "0"], "episodes: must be at least 1, got 0"),
        (["toy6", "--seconds", "-1"], "seconds: must be at least 0.001, got -1"),
        (["toy6", "--workers", "0"], "workers: must be at least 1, got 0"),
        (["toy6", "--split", "all"], "split is 'all'"),
    ],
)
def test_bad_input_is_one_line(arguments, message, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["check", *arguments])
    assert stopped.value.code == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1
