"""The commands that train, as a maintainer runs them: pareto, ablate and generalise."""

import pytest

from docs.studies.commands import main
from docs.studies.learning import ablate, pareto
from docs.studies.learning.trainings import folder

TINY = ("--updates", "2", "--episodes", "2", "--workers", "1")


def stopped(capsys, *arguments):
    """Status and standard error of a command that ends with an error."""
    with pytest.raises(SystemExit) as raised:
        main(list(arguments))
    return raised.value.code, capsys.readouterr().err


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Change to a temporary working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_pareto_trains_draws_and_does_nothing_twice(here, monkeypatch, capsys):
    monkeypatch.setattr(pareto, "K_P_MW_PER_PU", (0.0, 5.0))
    arguments = ["pareto", "--scenario", "toy6", "--delays", "4", *TINY, "--out", "docs"]
    main(arguments)
    said = capsys.readouterr().out
    assert "trainings are done already" not in said
    assert (here / "docs" / "images" / "pareto.png").read_bytes()[:4] == b"\x89PNG"
    page = (here / "docs" / "pareto.md").read_text()
    assert "| 4 s |" in page
    command = next(line for line in page.splitlines() if line.startswith("dcgrid train analytic --scenario toy6 "))
    assert {"--out results/pareto/toy6/delay-4-2-0", "--delay-limit-s 4", "--updates 2"} <= {
        f"--{option}".strip() for option in command.split("--")
    }
    before = (here / "results/pareto/toy6/delay-4-2-0/curve.csv").read_bytes()
    main(arguments)
    assert "2 of 2 trainings are done already" in capsys.readouterr().out
    assert (here / "docs" / "pareto.md").read_text() == page
    assert (here / "results/pareto/toy6/delay-4-2-0/curve.csv").read_bytes() == before


@pytest.mark.slow
def test_ablate_scores_variants_and_transfer(here, monkeypatch, capsys):
    monkeypatch.setattr(ablate, "VARIANTS", {"all": {}, "clock only": {"act": "clock"}})
    run = "results/ablate/toy6/act-clock-2-0/policy.safetensors"
    base = ("ablate", "--scenario", "toy6", *TINY, "--transfer", "toy6,ieee33", "--policies")
    main([*base, "none"])
    assert "Trained on one scenario" not in (here / "results/ablate/ablations.md").read_text()
    main([*base, run, "--out", "docs"])
    page = (here / "docs" / "ablations.md").read_text()
    rows = [line for line in page.splitlines() if line.startswith("|")]
    names = [row.split(" | ")[0].removeprefix("| ") for row in rows]
    assert [name for name in names if not name.startswith("|-")] == [
        *("variant", "all", "clock only", "monotone, gain below the stability bound (safe)", "droop-tuned"),
        *("policy", f"{run} (on toy6)"),
    ]
    assert "| \\[" in rows[-1]
    assert "# monotone, gain below the stability bound (safe)\ndcgrid train safe --scenario toy6 " in page


@pytest.mark.slow
def test_generalise_leaves_each_out(here):
    main(["generalise", "--scenarios", "toy6,ieee33", "--vary", "0", *TINY, "--out", "docs"])
    page = (here / "docs" / "generalise.md").read_text()
    assert "| toy6 | ieee33 | " in page
    assert "| ieee33 | toy6 | " in page


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("pareto", "--scenario", "ieee32"), "no scenario 'ieee32'; did you mean ieee33"),
        (("pareto", "--scenario", "toy6,ieee33"), "scenario: must be one name, got 'toy6,ieee33'"),
        (("pareto", "--delays", "1,-2"), "delays is '1,-2'; give figures above 0, separated by commas"),
        (("pareto", "--delays", "nan"), "delays is 'nan'; give figures above 0"),
        (("pareto", "--updates", "0"), "updates is 0; give at least 1"),
        (("ablate", "--seeds", "0"), "seeds: must be at least 1, got 0"),
        (("ablate", "--episodes", "1"), "episodes is 1; give 2 to 100"),
        (("ablate", "--transfer", "mars"), "no scenario 'mars'"),
        (("ablate", "--policies", "none-such"), "no policy 'none-such'; "),
        (("generalise", "--scenarios", "ieee33"), "scenarios is 'ieee33'; give at least two, one is left out"),
        (("generalise", "--vary", "-1"), "vary is -1; give at least 0"),
        (("generalise", "--workers", "0"), "workers: must be at least 1, got 0"),
        (("ablate", "--workers", "0"), "workers: must be at least 1, got 0"),
        (("pareto", "--workers", "0"), "workers: must be at least 1, got 0"),
    ],
)
def test_bad_input_is_one_line_before_anything_is_trained(here, capsys, arguments, said):
    code, error = stopped(capsys, *arguments)
    assert code == 2
    assert error.startswith(f"dcgrid: {said}")
    assert len(error.splitlines()) == 1
    assert not list(here.iterdir())


@pytest.mark.slow
def test_a_training_that_fails_stops_the_front_and_is_named(here, capsys):
    folder = here / "results/pareto/toy6/delay-4-2-0"
    folder.mkdir(parents=True)
    (folder / "config.json").write_text('{"scenario": "ieee33"}')
    code, error = stopped(capsys, "pareto", "--scenario", "toy6", "--delays", "4", *TINY)
    assert code == 2
    assert "1 of 2 trainings failed: " in error
    assert "scenario was 'ieee33' and is 'toy6' now" in error


def test_an_interruption_says_that_the_same_command_goes_on(here, monkeypatch, capsys):
    from dcgrid_env.agents.algorithms import analytic

    def interrupted(cfg):
        raise KeyboardInterrupt

    monkeypatch.setattr(analytic, "main", interrupted)
    code, error = stopped(capsys, "pareto", "--scenario", "toy6", *TINY)
    assert (code, error) == (130, "dcgrid: interrupted; run the same command again to resume\n")


def test_folders_of_different_settings_differ(tmp_path):
    named = [folder(tmp_path, "a,b", label, n, seed) for label in "xy" for n in (1, 2) for seed in (0, 1)]
    assert len(set(named)) == 8
    assert named[0] == tmp_path / "a+b" / "x-1-0"
