"""dcgrid dev pareto, ablate, generalise and curves, as a user runs them."""

import pytest

from dcgrid_env.agents import Card
from dcgrid_env.agents.studies import ablation, pareto
from dcgrid_env.cli.main import main

TINY = ("--updates", "2", "--episodes", "2", "--workers", "1")


def stopped(capsys, *arguments):
    """Status and standard error of a command that ends with an error."""
    with pytest.raises(SystemExit) as raised:
        main(list(arguments))
    return raised.value.code, capsys.readouterr().err


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A working folder of one's own."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_pareto_trains_draws_and_does_nothing_twice(here, monkeypatch, capsys):
    monkeypatch.setattr(pareto, "K_P_MW_PER_PU", (0.0, 5.0))
    arguments = ["dev", "pareto", "--scenario", "toy6", "--delays", "4", *TINY, "--out", "docs"]
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


def test_ablate_scores_variants_and_transfer(here, monkeypatch, capsys):
    monkeypatch.setattr(ablation, "VARIANTS", {"all": {}, "clock only": {"act": "clock"}})
    run = "results/ablate/toy6/act-clock-2-0/policy.safetensors"
    base = ("dev", "ablate", "--scenario", "toy6", *TINY, "--transfer", "toy6,ieee33", "--policies")
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


def test_generalise_leaves_each_out(here, capsys):
    main(["dev", "generalise", "--scenarios", "toy6,ieee33", "--vary", "0", *TINY, "--out", "docs"])
    page = (here / "docs" / "generalise.md").read_text()
    assert "| toy6 | ieee33 | " in page
    assert "| ieee33 | toy6 | " in page
    main(["dev", "curves", "results/generalise/without-toy6/ieee33-vary-0-2-0", "--out", "docs/images/curves.png"])
    assert (here / "docs/images/curves.png").read_bytes()[:4] == b"\x89PNG"
    assert "ieee33, analytic: 1 run, J at the end " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("dev", "pareto", "--scenario", "ieee32"), "no scenario 'ieee32'; did you mean ieee33"),
        (("dev", "pareto", "--scenario", "toy6,ieee33"), "scenario is 'toy6,ieee33'; give one"),
        (("dev", "pareto", "--delays", "1,-2"), "delays is '1,-2'; give figures above 0, separated by commas"),
        (("dev", "pareto", "--delays", "nan"), "delays is 'nan'; give figures above 0"),
        (("dev", "pareto", "--updates", "0"), "updates is 0; give at least 1"),
        (("dev", "ablate", "--seeds", "0"), "seeds is 0; give at least 1"),
        (("dev", "ablate", "--episodes", "1"), "episodes is 1; give 2 to 100"),
        (("dev", "ablate", "--transfer", "mars"), "no scenario 'mars'"),
        (("dev", "ablate", "--policies", "none-such"), "no policy 'none-such'; "),
        (("dev", "generalise", "--scenarios", "ieee33"), "scenarios is 'ieee33'; give at least two, one is left out"),
        (("dev", "generalise", "--vary", "-1"), "vary is -1; give at least 0"),
        (("dev", "generalise", "--workers", "0"), "workers is 0; give at least 1"),
        (("dev", "curves", "nowhere"), "nowhere: there is no curve.csv; give the folder of a training run"),
        (
            (
                "dev",
                "curves",
            ),
            "folders is empty; give the folder of at least one training run",
        ),
    ],
)
def test_bad_input_is_one_line_before_anything_is_trained(here, capsys, arguments, said):
    code, error = stopped(capsys, *arguments)
    assert code == 2
    assert error.startswith(f"dcgrid: {said}")
    assert len(error.splitlines()) == 1
    assert not list(here.rglob("curve.csv"))


def test_a_training_that_fails_stops_the_front_and_is_named(here, capsys):
    folder = here / "results/pareto/toy6/delay-4-2-0"
    folder.mkdir(parents=True)
    (folder / "config.json").write_text('{"scenario": "ieee33"}')
    code, error = stopped(capsys, "dev", "pareto", "--scenario", "toy6", "--delays", "4", *TINY)
    assert code == 2
    assert "1 of 2 trainings failed: " in error
    assert "scenario was 'ieee33' and is 'toy6' now" in error


def test_an_interruption_says_that_the_same_command_goes_on(here, monkeypatch, capsys):
    from dcgrid_env.agents.algorithms import analytic

    def interrupted(cfg):
        raise KeyboardInterrupt

    monkeypatch.setattr(analytic, "main", interrupted)
    code, error = stopped(capsys, "dev", "pareto", "--scenario", "toy6", *TINY)
    assert (code, error) == (130, "dcgrid: interrupted; the same command goes on from there\n")


def test_several_seeds_of_a_training(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = [
        "train",
        "analytic",
        "--scenario",
        "toy6",
        "--set",
        "horizon=10",
        "--seeds",
        "2",
        "--seed",
        "3",
        "--workers",
        "1",
    ]
    main([*words, "--updates", "1", "--num-envs", "2", "--validation-episodes", "2", "--hidden", "4", "--out", "runs"])
    said = capsys.readouterr().out
    assert "seed 3: J" in said
    assert "seed 4: J" in said
    assert "`dcgrid dev ship runs/seed-3 runs/seed-4 --name NAME`" in said
    for seed in (3, 4):
        card = Card.load(tmp_path / "runs" / f"seed-{seed}" / "policy.json")
        assert card.seed == seed
        assert "--seeds" not in card.command
        assert f"--seed {seed}" in card.command
    for asked in ("0", "many"):
        with pytest.raises(SystemExit):
            main(["train", "analytic", "--seeds", asked])
        assert capsys.readouterr().err.startswith("dcgrid: seeds")
