"""Names that the console library would read as markup are shown unchanged."""

from types import SimpleNamespace

import numpy as np
import pytest

from dcgrid_env.agents import Network, Policy
from dcgrid_env.cli.main import main
from docs.studies.commands import PROG
from docs.studies.commands import main as studies
from docs.studies.learning import ablate, pareto

NAME = "[/b]:key:"


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "300")
    return tmp_path


def a_run(folder):
    """A training run's folder."""
    networks = {"datacenter": Network([(np.zeros((9, 2)), [1.0, 0.2])])}
    networks["inverter"] = Network([(np.zeros((7, 1)), [0.2])])
    policy = Policy(networks, scenario="toy6", made_with="dcgrid train ppo")
    policy.save(folder / "policy", {"algorithm": NAME, "seed": 0, "training_s": 2.0, "validation_J": 0.3})
    (folder / "config.json").write_text('{"view": "shared"}')


TINY = f"--updates 2 --episodes 2 --workers 1 --runs {NAME}/runs --out {NAME}/out"
PLAIN = NAME.replace("/", "")
SAID = {
    f"{PROG} ship {NAME}/run --name {PLAIN} --scenario toy6 --episodes 2 --out {NAME}": (
        f"{PLAIN}: {NAME} trained on toy6",
        f"wrote {NAME}/{PLAIN}",
    ),
    f"traces show {NAME}.csv --against {NAME}.csv --out {NAME}/trace.png": (f"{NAME}.csv: 9 s", f"{NAME}/trace.png"),
    f"traces record {NAME}.gz": (f"wrote {NAME}.gz: 2 samples",),
    f"traces fetch {NAME}": (f"{NAME}/file\na recording", "licence: [/]"),
    f"train analytic --scenario toy6 --updates 2 --num-envs 2 --out {NAME}": (f"{NAME}: ",),
    f"{PROG} pareto --scenario toy6 --delays 4 {TINY}": (f"the first: {NAME}/runs/", f"wrote {NAME}/out/pareto.md"),
    f"{PROG} ablate --scenario toy6 {TINY} --transfer toy6 --policies {NAME}/run/policy.safetensors": (
        f"{NAME}/run/policy.safetensors (on toy6)",
        f"wrote {NAME}/out/ablations.md",
    ),
    f"{PROG} generalise --scenarios toy6,ieee33 --vary 0 {TINY}": (
        f"the first: {NAME}/runs/",
        f"wrote {NAME}/out/general",
    ),
    f"reproduce --trace {NAME}.csv --out {NAME}/out": (f"load: {NAME}.csv", f"wrote {NAME}/out/reproduction.md"),
}


@pytest.mark.parametrize(
    "command",
    [pytest.param(c, marks=[pytest.mark.slow] if c.startswith(PROG) else [], id=c.partition("[")[0]) for c in SAID],
)
def test_what_a_user_names_is_shown_as_it_is(here, monkeypatch, capsys, command):
    a_run(here / NAME / "run")
    (here / f"{NAME}.csv").parent.mkdir(parents=True, exist_ok=True)
    (here / f"{NAME}.csv").write_text("".join(f"{time_s},{100 + time_s}\n" for time_s in range(10)))
    monkeypatch.setattr(pareto, "K_P_MW_PER_PU", (0.0,))
    monkeypatch.setattr(ablate, "VARIANTS", {"all": {}})
    records = {"claims": [], "setting": {"load_description": f"{NAME}.csv"}}
    monkeypatch.setattr("dcgrid_env.apps.reproduction.study.study", lambda runs, done, place: done(NAME) or records)
    monkeypatch.setattr("dcgrid_env.apps.reproduction.markdown.render", lambda records: "")
    command_class = "dcgrid_env.apps.reproduction.reproduce_command.Reproduce"
    monkeypatch.setattr(f"{command_class}.setting", lambda self: (None, {}))
    noted = {"samples": 2, "gpus": [1], "missed": 0, "jitter_s": {"mean": 0.0, "p99": 0.0}}
    monkeypatch.setattr("dcgrid_env.traces.recorder.record", lambda *given, **named: noted)
    recording = SimpleNamespace(description="a recording", sha256="0", licence="[/]", citation="[/]")
    monkeypatch.setattr("dcgrid_env.traces.recordings.RECORDINGS", {NAME: recording})
    monkeypatch.setattr("dcgrid_env.traces.recordings.fetch", lambda *given: f"{NAME}/file")
    words = command.removeprefix(PROG).split()
    (studies if command.startswith(PROG) else main)(words)
    printed = capsys.readouterr().out
    for text in SAID[command]:
        assert text in printed


def test_the_progress_of_a_training_shows_its_scenario_as_it_is(capsys):
    from dcgrid_env.agents.training.training_loop import progress

    with progress(NAME, 2, 0) as advance:
        advance(2, NAME)
    assert capsys.readouterr().out.count(NAME) == 2
