"""dcgrid train, evaluate, ship and the list of policies, as a user runs them."""

import json
import re
import subprocess
import sys
from dataclasses import dataclass
from types import ModuleType

import numpy as np
import pytest

import dcgrid_env.agents
import dcgrid_env.agents.policy.policy as policies
from dcgrid_env import make_scenario, scenario_hash
from dcgrid_env.agents import Card, Network, Policy, controllers, evaluate
from dcgrid_env.agents.train_command import ALGORITHMS
from dcgrid_env.agents.training.config import Training
from dcgrid_env.baselines import make_controller
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.baselines.tuning.tuned import identity
from dcgrid_env.cli.main import main
from docs.studies.commands import main as studies


@dataclass(frozen=True)
class Ppo(Training):
    """Nothing more."""

    steps: int = 10


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """A folder of the test's own, where what no --out names is written."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def module(monkeypatch):
    """A stand-in for an algorithm."""
    made = ModuleType("dcgrid_env.agents.algorithms.sb3", "A stand-in.")
    made.Ppo = Ppo  # type: ignore[attr-defined]
    made.main = lambda cfg: seen.append(cfg) or "run"  # type: ignore[attr-defined]
    made.seen = seen = []  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, made.__name__, made)
    return made


def stopped(capsys, *arguments):
    """Status and standard error of a command that ends with an error."""
    with pytest.raises(SystemExit) as raised:
        main(list(arguments))
    return raised.value.code, capsys.readouterr().err


def policy(dc=(1.0, 0.3), inv=0.3, scenario="toy6"):
    networks = {"datacenter": Network([(np.zeros((9, 2)), dc)]), "inverter": Network([(np.zeros((7, 1)), [inv])])}
    return Policy(networks, scenario=scenario, made_with="dcgrid train ppo")


def test_an_algorithm_gets_its_own_options_and_what_ships_is_said(module, capsys):
    main(["train", "ppo", "--scenario", "scale-32", "--seed", "3"])
    assert module.seen == [Ppo.for_scenario("scale-32", seed=3)]
    assert "bundled settings for ppo on scale-32: num_envs 16, steps 20000, " in capsys.readouterr().out


def test_bad_training_is_one_line(module, capsys):
    from dcgrid_env.agents.training.run_folder import TrainingError

    code, said = stopped(capsys, "train", "dqn", "--seed", "3")
    assert (code, len(said.splitlines())) == (2, 1)
    assert said == "dcgrid: no command 'dqn'; `dcgrid train --help` lists all\n"

    def diverges(cfg):
        raise TrainingError("training diverged at step 7")

    module.main = diverges
    assert stopped(capsys, "train", "ppo") == (2, "dcgrid: training diverged at step 7\n")

    def interrupted(cfg):
        raise KeyboardInterrupt

    module.main = interrupted
    code, said = stopped(capsys, "train", "ppo")
    assert (code, said) == (130, "dcgrid: interrupted; run the same command with --resume to continue\n")
    assert stopped(capsys, "train", "ppo", "--colour", "1")[0] == 2


def test_a_view_that_cannot_be_is_the_error_alone(recwarn, capsys):
    code, said = stopped(capsys, "train", "safe", "--view", "centralised")
    assert (code, len(said.splitlines())) == (2, 1)
    assert said.startswith("dcgrid: view is 'centralised' and observe 'local'; a safe policy is shared and local")
    code, said = stopped(capsys, "train", "td3", "--view", "none")
    assert code == 2
    assert "invalid choice 'none' for argument '--view'" in said
    assert not recwarn.list


NEEDS_TORCH = ("dcgrid_env.agents.algorithms.", "dcgrid_env.agents.training.")


def test_training_without_torch_says_what_to_install(monkeypatch, capsys):
    for missing in ("torch", "stable_baselines3"):
        with monkeypatch.context() as context:
            context.setitem(sys.modules, missing, None)
            for name in [name for name in sys.modules if name.startswith("dcgrid_env.agents.")]:
                context.delitem(sys.modules, name)
                child = name.split(".")[2]  # importing it again replaces this attribute of the package
                context.setattr(dcgrid_env.agents, child, getattr(dcgrid_env.agents, child))
            code, said = stopped(capsys, "train", "ppo")
        assert code == 2
        assert missing in said
        assert "in a clone of the repository: pip install -e '.[agents]'" in said


@pytest.mark.slow
def test_help_lists_the_algorithms_without_torch():
    code = (
        "import sys\nfrom dcgrid_env.cli.main import main\n"
        "try:\n    main(['train', '--help'])\nexcept SystemExit:\n    pass\n"
        "print([m for m in sys.modules if m.startswith(('torch', 'dcgrid_env.agents'))])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert all(f"  {name} " in done.stdout for name in ALGORITHMS)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize("name", ALGORITHMS)
def test_every_algorithm_is_there_with_its_configuration(name):
    settings = ALGORITHMS[name].configuration()()
    assert {"scenario", "seed", "out", "device", "resume"} <= set(vars(settings))
    assert callable(ALGORITHMS[name].module().main)


@pytest.mark.slow
def test_evaluate_prints_the_policy_beside_its_rivals(tmp_path, capsys):
    path = policy(dc=(-0.9, 0.3)).save(tmp_path / "run" / "policy")
    for named in (str(path), str(path.parent)):
        main(["evaluate", named, "--episodes", "3"])
        printed = " ".join(capsys.readouterr().out.split())
        assert "toy6, test split, 3 episodes" in printed
        assert "is longer than the tuned droop's" in printed
        assert "of constant-q-tuned, which uses no measurements" in printed
        test = make_scenario("toy6", split="test")
        own, droop = (evaluate(c, test, range(3)) for c in (Policy.load(path), make_controller("droop-tuned", test)))
        assert f"J {own.means['J']:.4f} {droop.means['J']:.4f}" in printed
        assert f"score {own.score(droop).score.value:.3f} 0.000" in printed


def test_a_training_s_folder_runs_no_code_and_says_what_is_wrong_with_it(tmp_path, capsys):
    folder = policy().save(tmp_path / "run" / "policy").parent
    (tmp_path / "mine.py").write_text("open('ran', 'w')\n")
    for config, message in (
        (
            {"scenario": "mine.py:make"},
            "scenario must not be code unless trusted, got 'mine.py:make'; pass it with --scenario",
        ),
        ({"scenario": ["toy6"]}, "config.json: scenario and set must be text; pass --scenario and the policy file"),
        ({"scenario": "toy6", "set": 3}, "config.json: scenario and set must be text"),
        ([], "config.json: is no configuration of a training run"),
    ):
        (folder / "config.json").write_text(json.dumps(config))
        code, said = stopped(capsys, "evaluate", str(folder), "--episodes", "2")
        assert (code, len(said.splitlines())) == (2, 1)
        assert message in said
    assert not (tmp_path / "ran").exists()


@pytest.mark.filterwarnings("ignore::dcgrid_env.agents.UnseenScenarioWarning")
@pytest.mark.slow
def test_evaluate_off_the_test_split_has_no_score_and_says_so(tmp_path, capsys):
    path = policy().save(tmp_path / "mine")
    main(["evaluate", str(path), "--scenario", "ieee33", "--split", "validation", "--episodes", "2"])
    printed = " ".join(capsys.readouterr().out.split())
    assert "no score: hindsight costs are missing for 2 of the 2 episodes; add --hindsight to solve them in " in printed
    assert "95 %" not in printed
    assert "is longer than" not in printed


def test_bad_evaluations_are_one_line(tmp_path, capsys):
    path = str(policy(scenario="elsewhere").save(tmp_path / "mine"))
    joint = Policy({"joint": Network([(np.zeros((23, 4)), [0.0] * 4)])}, scenario="toy6").save(tmp_path / "joint")
    (tmp_path / "cut.safetensors").write_bytes(joint.read_bytes()[:-9])
    for arguments, message in (
        ([path], "scenario: must be given for policy "),
        (["mpc"], "scenario: must be given for policy 'mpc'"),
        ([path, "--scenario", "ieee124"], "no scenario 'ieee124'"),
        ([path, "--scenario", "toy6", "--episodes", "0"], "episodes: must be at least 1, got 0"),
        ([path, "--scenario", "toy6", "--split", "exam"], "split is 'exam'"),
        (
            [str(joint), "--scenario", "ieee123"],
            "takes 23 figures and gives 4, on ieee123 (5 of kind datacenter, 7 of kind inverter",
        ),
        ([str(tmp_path / "cut.safetensors")], "not a policy file"),
        (["pid", "--scenario", "toy6"], "no controller 'pid'"),
        (["guarded:", "--scenario", "toy6"], "controller 'guarded:': nothing follows; write a policy's name or file"),
        (["", "--scenario", "toy6"], "no controller ''"),
    ):
        code, said = stopped(capsys, "evaluate", *arguments)
        assert code == 2
        assert said.startswith("dcgrid: ")
        assert message in said
        assert len(said.strip().splitlines()) == 1


@pytest.mark.slow
def test_what_ships_can_be_listed_run_and_benchmarked_by_name(tmp_path, capsys, monkeypatch):
    made = {"algorithm": "ppo", "seed": 0, "training_s": 1.0, "validation_J": 0.3}
    policy().save(tmp_path / "run" / "policy", made)
    studies(["ship", str(tmp_path / "run"), "--name", "toy6-ppo", "--episodes", "2", "--out", str(tmp_path / "out")])
    assert "toy6-ppo: ppo trained on toy6, 28 parameters; score" in " ".join(capsys.readouterr().out.split())
    for module, name, value in (
        (policies, "FOLDER", tmp_path / "out"), (policies, "SHIPPED", ("toy6-ppo",)),
        (controllers, "TRAINED", {"ppo": ("toy6",)}),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, value)
    main(["list"])
    assert "ppo trained on toy6, 28 parameters; score" in " ".join(capsys.readouterr().out.split())
    main(["evaluate", "toy6-ppo", "--episodes", "2"])
    assert "toy6, test split, 2 episodes" in capsys.readouterr().out
    run = ["--scenario", "toy6", "--controllers", "toy6-ppo,ppo", "--episodes", "2", "--out", str(tmp_path / "r")]
    main(["run", *run])
    bench = ["--scenarios", "toy6,ieee33", "--controllers", "ppo", "--episodes", "2", "--workers", "1"]
    main(["benchmark", *bench, "--out", str(tmp_path / "b")])
    printed = " ".join(capsys.readouterr().out.split())
    assert "ieee33, ppo: does not apply: controller 'ppo': none ships for 'ieee33', but for toy6" in printed


OWN = """
from dcgrid_env import load_feeder, make_scenario

def make():
    weak = {"datacenters": {"buses": (27, 65, 35)}, "inverters": {"buses": (5, 12, 40, 61)}}
    return make_scenario("ieee33-weak", name="[/]", feeder=load_feeder("das69"), horizon=10, **weak)
"""
GAINS = {"k_p_mw_per_pu": 0.0, "k_q_mvar_per_pu_s": 1.0, "alpha_per_s": 0.3}


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty folder with a scenario of the user's own and gains of a droop for it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "300")
    (tmp_path / "own.py").write_text(OWN)
    entry = {"parameters": GAINS} | identity(ScenarioSpec("own.py:make").make("validation"))
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "tuned.json").write_text(json.dumps({"laws": {"droop": {"[/]": entry}}}))
    return tmp_path


@pytest.mark.slow
def test_evaluate_on_ones_own_scenario_says_what_is_missing_and_solves_it(here, capsys):
    command = ["evaluate", "none", "--scenario", "own.py:make", "--episodes", "2", "--workers", "1"]
    main(command)
    printed = capsys.readouterr().out
    assert "[/], test split, 2 episodes" in printed
    said = r"no score: hindsight costs are missing for 2 of the 2 episodes; add --hindsight to solve them in "
    assert re.search(said + r"about \S+ s to \S+ s \(one linear program takes \S+ s, an episode needs 2 to 6", printed)
    assert "constant-q-tuned is omitted: no tuned parameters of 'constant-q' for scenario '[/]'" in printed
    assert "dcgrid tune --laws constant-q --scenarios own.py:make" in printed
    assert "droop-tuned: gains for [/] from results/tuned.json" in printed
    assert not (here / "results" / "hindsight").exists()
    main([*command, "--hindsight"])
    assert "\n score " in capsys.readouterr().out
    (path,) = (here / "results" / "hindsight").iterdir()
    assert [e["seed"] for e in json.loads(path.read_text())["episodes"]] == [0, 1]
    # What is there is found again, and only what is missing is solved.
    before = path.read_text()
    main(command)
    assert "\n score " in capsys.readouterr().out
    assert path.read_text() == before
    main([*command, "--hindsight", "--seed", "1"])
    assert "[/], test split, 2 episodes, seeds from 1" in capsys.readouterr().out
    assert [e["seed"] for e in json.loads(path.read_text())["episodes"]] == [0, 1, 2]


@pytest.mark.slow
def test_episodes_beyond_those_that_ship_are_solved(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    main(["evaluate", "none", "--scenario", "toy6", "--seed", "98", "--episodes", "3", "--hindsight", "--workers", "1"])
    assert "\n score " in capsys.readouterr().out
    kept = json.loads((tmp_path / "results" / "hindsight" / "toy6.json").read_text())
    assert [e["seed"] for e in kept["episodes"]] == [100]


def test_a_file_of_another_scenario_is_refused_before_anything_is_run(here, capsys):
    folder = here / "results" / "hindsight"
    folder.mkdir()
    (folder / "toy6.json").write_text(json.dumps({"scenario_hash": "0" * 16, "episodes": []}))
    command = ["evaluate", "none", "--scenario", "toy6", "--split", "validation", "--episodes", "2"]
    code, said = stopped(capsys, *command, "--hindsight")
    assert (code, len(said.splitlines())) == (2, 1)
    assert "toy6.json belongs to a different scenario named toy6; move the file" in said


@pytest.mark.slow
def test_a_scenario_that_hindsight_cannot_solve_says_so(here, capsys):
    main(["evaluate", "none", "--scenario", "toy6", "--set", "cost.voltage=l2", "--episodes", "2"])
    assert "no score: hindsight minimises the l1 voltage cost only, not 'l2'" in capsys.readouterr().out


@pytest.mark.parametrize(
    "options",
    [
        ("analytic", "--updates", "2", "--num-envs", "4"),
        ("ppo", "--steps", "240", "--num-envs", "2", "--outputs", "droop"),
    ],
)
@pytest.mark.slow
def test_training_on_ones_own_scenario(options, here, capsys):
    command = [
        "train",
        *options,
        "--scenario",
        "own.py:make",
        "--validation-episodes",
        "2",
        "--set",
        "background.load_sigma=0.1",
    ]
    main(command)
    (folder,) = (here / "results" / "train").iterdir()
    about = json.loads((folder / "config.json").read_text())
    scenario = ScenarioSpec("own.py:make", ("background.load_sigma=0.1",)).make("validation")
    assert (about["scenario"], about["set"]) == ("own.py:make", ["background.load_sigma=0.1"])
    assert about["scenario_hashes"] == [scenario_hash(scenario)]
    assert Policy.load(folder / "policy.safetensors").trained_on == "own.py:make --set background.load_sigma=0.1"
    capsys.readouterr()
    assert "scenario must not be code unless trusted, got 'own.py:make'" in stopped(capsys, "evaluate", str(folder))[1]
    main(["evaluate", str(folder), "--episodes", "2", "--trust"])
    assert "[/], test split, 2 episodes" in capsys.readouterr().out
    # Another content of the file is another scenario.
    (here / "own.py").write_text(OWN.replace("horizon=10", "horizon=11"))
    code, said = stopped(capsys, *command, "--resume")
    assert code == 2
    assert "scenario_hashes was" in said


def test_training_without_gains_of_the_reference_leaves_no_folder(here, capsys):
    for algorithm in ("ppo", "analytic"):
        code, said = stopped(capsys, "train", algorithm, "--scenario", "ieee33", "--set", "source_voltage_pu=1.0")
        assert (code, len(said.splitlines())) == (2, 1)
        assert "find its own with `dcgrid tune --laws droop --scenarios ieee33 --set source_voltage_pu=1.0`" in said
    assert not (here / "results" / "train").exists()


@pytest.mark.slow
def test_training_takes_devices_in_any_order(here):
    turned = "from dcgrid_env import make_scenario\n\ntoy6 = make_scenario('toy6', horizon=4)\n"
    (here / "turned.py").write_text(turned + "scenario = toy6.replace(name='turned', devices=toy6.devices[::-1])\n")
    main([
        "tune", "--laws", "droop", "--scenarios", "turned.py:scenario", "--episodes", "1", "--out",
        "results/tuned.json",
    ])  # fmt: skip
    main(["train", "analytic", "--scenario", "turned.py:scenario", "--updates", "1", "--num-envs", "2", "--out", "run"])
    learned = Policy.load(here / "run" / "policy.safetensors")
    assert {name: network.n_out for name, network in learned.networks.items()} == {"inverter": 1, "datacenter": 2}


@pytest.mark.slow
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
    for seed in (3, 4):
        card = Card.load(tmp_path / "runs" / f"seed-{seed}" / "policy.json")
        assert card.seed == seed
        assert "--seeds" not in card.command
        assert f"--seed {seed}" in card.command
    for asked in ("0", "many"):
        with pytest.raises(SystemExit):
            main(["train", "analytic", "--seeds", asked])
        assert capsys.readouterr().err.startswith("dcgrid: seeds")
