"""results.json with something changed: dcgrid replay refuses it in one line, or the episode is the stored one."""

import json
import random
import re
from types import SimpleNamespace

import pytest

from dcgrid_env.cli.main import main
from helpers.fuzzing import ODD_JSON, mutated_bytes

WORDS = ("run", "--scenario", "toy6", "--set", "horizon=4", "--episodes", "1", "--seed", "3", "--controllers", "none")
ODD = [*ODD_JSON, "'", "dcgrid run"]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """What a run has written."""
    folder = tmp_path_factory.mktemp("run")
    main([*WORDS, "--out", str(folder)])
    return (folder / "results.json").read_bytes()


@pytest.fixture
def replayed(results, tmp_path, capsys, monkeypatch):
    """Whether another text of results.json is replayed, and to the cost that it says; else it is refused."""
    pages = []
    page = SimpleNamespace(write=lambda path: path.write_text("a page"))
    monkeypatch.setattr("dcgrid_env.rendering.replay", lambda runs, title: pages.append(runs) or page)
    (episode,) = json.loads(results)["episodes"]

    def replay(content: bytes) -> bool:
        (tmp_path / "results.json").write_bytes(content)
        capsys.readouterr()
        status = None
        try:
            main(["replay", str(tmp_path)])
        except SystemExit as ended:
            status = ended.code
        if status is not None:
            assert status == 2
            (line,) = capsys.readouterr().err.splitlines()
            assert line.startswith("dcgrid: ")
            return False
        ((name, run),) = pages.pop().items()
        assert name == "none"
        cost = run.cost_j.sum() / run.scenario.horizon
        said = re.search(r"J is .*, but .* in the stored run", capsys.readouterr().out)
        assert said or episode["J"] == pytest.approx(cost, rel=1e-9, abs=1e-12)
        return True

    return replay


@pytest.mark.slow
def test_damaged_results_are_refused_or_replayed_as_they_were(results, replayed):
    rng = random.Random(5)
    outcomes = [replayed(mutated_bytes({"results": results}, rng)["results"]) for _ in range(150)]
    assert set(outcomes) == {True, False}


@pytest.mark.parametrize("field", ["meta", "meta.command", "meta.scenario_hash", "episodes", "episodes.0"])
@pytest.mark.slow
def test_odd_values_in_the_fields_that_a_replay_reads_are_refused(results, replayed, field):
    for value in ODD:
        content = json.loads(results)
        *parts, last = [int(part) if part.isdigit() else part for part in field.split(".")]
        place = content
        for part in parts:
            place = place[part]
        place[last] = value
        assert not replayed(json.dumps(content).encode()), value


@pytest.mark.parametrize(
    "words",
    [
        tuple("4" if word == "3" else word for word in WORDS),
        (*WORDS[:-1], "droop"),
        (*WORDS[:4], "horizon=5", *WORDS[5:]),
        (*WORDS, "--no-such-option"),
        ("train", *WORDS[1:]),
    ],
)
def test_another_command_is_refused(results, replayed, words):
    content = json.loads(results)
    content["meta"]["command"] = " ".join(["dcgrid", *words])
    assert not replayed(json.dumps(content).encode())
