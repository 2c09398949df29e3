"""Every command and every block of code in the documents runs.

Commands run in the order of the document, in a separate folder. They are unchanged except for slow options:
``SHORTER`` gives these smaller values, so the options that a document names are parsed and used. A command of a kind
that is not listed fails. Commands within a sentence are only parsed.
"""

import contextlib
import importlib.util
import io
import itertools
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dcgrid_env import load_feeder
from dcgrid_env.agents.policy.policy import FOLDER
from dcgrid_env.cli import main
from docs.studies import commands as studies
from helpers.places import ROOT

DOCUMENTS = sorted(
    path.relative_to(ROOT).as_posix()
    for pattern in ("*.md", "docs/**/*.md", "traces/*.md")
    for path in ROOT.glob(pattern)
    if path.name != "CHANGELOG.md"
)

TRAINING = {"--updates": "1", "--num-envs": "2", "--validation-episodes": "2"}
STEPS = {"--steps": "240", "--num-envs": "2", "--validation-episodes": "2"}
SEARCH = {
    "--num-envs": "2", "--population": "2", "--elites": "2", "--iterations": "1", "--validation-episodes": "2",
}  # fmt: skip
SHORTER = {
    "dcgrid run": {"--episodes": "2"},
    "dcgrid run --scenario ieee33-weak --horizon 86400": {"--horizon": "40"},
    "dcgrid run --scenario ieee33-weak --horizon 1440": {"--horizon": "4"},
    "dcgrid benchmark": {"--episodes": "2", "--workers": "1"},
    "dcgrid benchmark --controllers all": {"--episodes": "2", "--workers": "1", "--scenarios": "toy6"},
    "dcgrid benchmark --scenarios smoothing": {"--episodes": "1", "--workers": "1"},  # of 6000 steps each
    "dcgrid benchmark --scenarios ieee33-weak,mixed": {"--episodes": "2", "--workers": "1", "--scenarios": "toy6"},
    "dcgrid train analytic": TRAINING,
    "dcgrid train analytic --vary 4": TRAINING | {"--vary": "1"},
    "dcgrid train safe": TRAINING,
    "dcgrid train cem": SEARCH,
    "dcgrid train affine": SEARCH,
    "dcgrid train carry-over": TRAINING | {"--feeders": "1", "--steps": "2", "--validation-feeders": "1"},
    "dcgrid train ppo": STEPS,
    "dcgrid evaluate": {"--episodes": "2"},
    "dcgrid submit": {"--episodes": "2"},
    "dcgrid verify": {},
    "python -m docs.studies ship": {"--episodes": "2", "--out": "results/ship"},
    "python -m docs.studies export-hub": {"--episodes": "2"},
    "dcgrid replay": {"--set": "horizon=4"},
    "dcgrid check": {"--episodes": "1", "--seconds": "1", "--workers": "1"},
    "dcgrid import matpower": {},
    "dcgrid tune": {"--episodes": "1", "--laws": "droop", "--workers": "1"},
    "dcgrid hindsight": {"--episodes": "2", "--workers": "1"},
    "dcgrid capacity": {"--samples": "2", "--window-s": "24", "--buses": "18", "--workers": "1"},
    "dcgrid capacity --feeder ieee123-3ph": {"--samples": "2", "--window-s": "24", "--workers": "1"},
    "python -m docs.studies random-feeders": {"--draws": "2", "--n-bus": "20"},
    "dcgrid dataset": {"--episodes": "3"},
    "dcgrid list": {},
    "python -m docs.studies.pictures.picture": {},
    "python -m docs.studies.publishing.agents": {},
    "python -m docs.studies.publishing.headline": {},
    "python -m docs.studies.speed.compiled_twins": {"--rounds": "1", "--presets": "toy6"},
}
"""Options that are given these values, by how a command begins."""

ELSEWHERE = {
    "dcgrid benchmark --ray auto": "tests/dcgrid_env/cli/test_on_a_cluster.py",
    "dcgrid tune --ray 10.0.0.7:6379": "tests/dcgrid_env/cli/test_on_a_cluster.py",
    "dcgrid hindsight --ray ray://head.example:10001": "tests/dcgrid_env/cli/test_on_a_cluster.py",
    "dcgrid tune --laws set-points": "tests/baselines/test_tune_and_hindsight.py",
    "dcgrid train analytic --ray auto": "tests/dcgrid_env/cli/test_on_a_cluster.py",
    "python -m docs.studies benchmark-data": "tests/docs/studies/publishing/test_benchmark_data.py",
    "python -m docs.studies pareto": "tests/docs/studies",
    "python -m docs.studies libraries": "tests/docs/studies/learning/test_libraries.py",
    "python -m docs.studies algorithms": "tests/docs/studies/learning/test_algorithms.py",
    "python -m docs.studies ablate": "tests/docs/studies",
    "python -m docs.studies generalise": "tests/docs/studies",
    "python -m docs.studies unseen-feeders": "tests/docs/studies",
    "python -m docs.studies transfer": "tests/docs/studies",
    "python -m docs.studies sags": "tests/docs/studies",
    "dcgrid replay results/run": "tests/dcgrid_env/cli/test_replay.py",  # there of a run that the shell began
    "dcgrid reproduce": "tests/apps/reproduction/test_reproduce_command.py",
    "python -m docs.studies reproduction": "tests/docs/studies/paper/test_reproduction_page.py",
    "python -m docs.studies reproduction-3ph": "tests/docs/studies/paper/test_reproduction_page.py",
    "python -m docs.studies fit-paper": "tests/docs/studies/paper/test_fit_paper.py",
    "dcgrid run --feeder my-feeder": "tests/dcgrid_env/cli/test_own_feeder.py",  # there on a folder
    "dcgrid study": "tests/apps/hosting/connection_study/test_study_command.py",
    "dcgrid import gridlabd": "tests/apps/importers/test_gridlabd_import.py",
    "dcgrid import opendss": "tests/apps/importers/test_opendss_import.py",
    "dcgrid import pandapower": "tests/apps/importers/test_grid_import.py",
    "dcgrid import power-grid-model": "tests/apps/importers/test_grid_import.py",
    "dcgrid export": "tests/apps/importers/test_grid_import.py",
    "python -m docs.studies corpus": "tests/docs/studies/grids/test_corpus.py",
    "python tests/support/large_grid.py": "tests/apps/importers/test_large_grid.py",
    "dcgrid traces check": "tests/dcgrid_env/cli/test_traces.py",
    "dcgrid traces fetch": "tests/dcgrid_env/cli/test_traces.py",  # there from a server of the test's own
    "dcgrid traces show": "tests/dcgrid_env/cli/test_traces.py",
    "dcgrid traces record": "tests/dcgrid_env/cli/test_traces.py",  # there without a GPU
    # there with a Chromium
    "python -m docs.studies.pictures.replay_picture": "tests/dcgrid_env/rendering/test_replay_in_browser.py",
    "python -m docs.studies.speed.long_episodes": "tests/docs/studies/speed/test_long_episodes.py",
    "python -m docs.studies.laws.coordination": "tests/docs/studies/laws/test_coordination.py",
    "python -m docs.studies.grids.relays": "tests/dcgrid_env/devices/tap_changer/test_against_opendss.py",
    "python -m docs.studies.speed.paired_speed": "tests/docs/studies/speed/test_paired_speed.py",
    "python -m docs.studies.speed.first_step": "tests/docs/studies/speed/test_first_step.py",
    "python docs/examples/sb3_plain.py": "tests/docs/test_examples.py",
    "python docs/examples/sb3_vec_env.py": "tests/docs/test_examples.py",
    "python docs/examples/custom_training.py": "tests/docs/test_examples.py",
    "dcgrid export-sb3": "tests/agents/from_sb3",
    "dcgrid evaluate rllib_policy.py:FromRllib": "tests/docs/test_frameworks.py",
    "dcgrid evaluate torchrl_policy.py:FromTorchRl": "tests/docs/test_frameworks.py",
    "python -m docs.studies leaderboard": "tests/apps/leaderboard",
    "dcgrid verify docs/leaderboard/*": "tests/apps/leaderboard",
    "dcgrid verify docs/leaderboard/toy6-analytic": "tests/apps/leaderboard",
    "docker": "tests/apps/leaderboard",  # there without Docker
    "dcgrid evaluate mine.py:Mine": "tests/docs/test_examples.py",
    "dcgrid evaluate mine.zip": "tests/agents/from_sb3/test_commands.py",
    "dcgrid evaluate ppo.zip": "tests/agents/from_sb3/test_commands.py",
    "dcgrid benchmark --controllers none,mpc,ieee33-weak-analytic,ppo.zip": "tests/agents/from_sb3/test_commands.py",
    "dcgrid run --scenario ieee33-weak --controllers mine.zip,droop-tuned": "tests/agents/from_sb3/test_commands.py",
    "dcgrid replay --scenario ieee33-weak --compare mine.zip": "tests/agents/from_sb3/test_commands.py",
    "dcgrid submit mine.zip": "tests/agents/from_sb3/test_commands.py",
    "python docs/examples/cleanrl_ppo.py": "tests/docs/test_examples.py",
    "python docs/examples/offline_awr.py": "tests/docs/test_examples.py",
    "python docs/examples/offline_d3rlpy.py": "tests/docs/test_frameworks.py",
    "python docs/examples/constrained_ppo.py": "tests/docs/test_examples.py",
    "python docs/examples/torchrl_pettingzoo.py": "tests/docs/test_frameworks.py",
    "python docs/examples/rllib_multi_agent.py": "tests/docs/test_frameworks.py",
    "python docs/examples/rllib_native_batch.py": "tests/docs/test_frameworks.py",
    "python docs/examples/torchrl_tensor_env.py": "tests/docs/test_frameworks.py",
    "python docs/examples/benchmarl_mappo.py": "tests/docs/test_frameworks.py",
    "python docs/examples/jax_callback.py": "tests/docs/test_frameworks.py",
    "python docs/examples/jax_dlpack.py": "tests/docs/test_frameworks.py",
    "python -m dcgrid_env.traces.timing": "tests/traces/test_timing.py",
    "python -m docs.studies.traces.generated_requests": "tests/traces/test_readme.py",
    "python -m docs.studies.traces.compared_tasks": "tests/traces/test_readme.py",
    "python -m docs.studies.traces.generated_power": "tests/traces/test_readme.py",
    "python -m docs.studies.traces.generated_inference": "tests/traces/test_readme.py",
    "python -m docs.studies speed-sizes": "tests/docs/studies/speed/test_size_table.py",
    "python -m docs.studies speed": "tests/docs/studies/speed/test_rates.py",
    "python tests/mutation/run.py": "tests/mutation/test_mutation.py",
    "python -m venv": ".ci/run",
    "python -m pip": ".ci/run",
    "python -m pytest": ".ci/run",
    "python -m sphinx": ".ci/run",
    "ruff check": ".ci/run",
    "ruff format": ".ci/run",
    "pyright": ".ci/run",
    "bash .ci/run": ".ci/run",
}
"""What is run by another test or by the submission's checks, and only read here, by how a command begins."""

STUDIES = ["python", "-m", "docs.studies"]
WORD = re.compile(r"(?:\.venv/bin/)?(dcgrid|python3?|ruff|pyright|bash)(?= )")
SAVED_AS = re.compile(r"\b(\w+\.py):(\w+)")
TOML_NAME = re.compile(r"# ([\w-]+\.toml)$", re.MULTILINE)
"""First line of a block of TOML: the name of the file that it stands for."""


class Document:
    """A document's blocks: those of Python, files in TOML by their names, and its commands."""

    def __init__(self, name):
        self.name = name
        text = (ROOT / name).read_text(encoding="utf-8")
        fences = re.findall(r"^```(\w*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
        assert {kind for kind, _ in fences} <= {"python", "bash", "toml"}, (
            f"{name}: a block of a kind that nothing runs"
        )
        self.python = [block for kind, block in fences if kind == "python"]
        self.toml = {TOML_NAME.findall(block)[0]: block for kind, block in fences if kind == "toml"}
        prose = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
        indented = [line[4:] for line in prose.splitlines() if line.startswith("    ") and WORD.match(line[4:])]
        bash = "".join(block for kind, block in fences if kind == "bash").replace("\\\n", " ").splitlines()
        self.lines = [line for line in (*bash, *indented) if line.strip() and not line.startswith("#")]
        spans = [re.sub(r"\s+", " ", span) for span in re.findall(r"`([^`]+)`", prose)]
        self.inline = [span for span in spans if WORD.match(span) and " " in span]

    def commands(self):
        """Words of every command, in order, as the shell gives them on."""
        for line in self.lines:
            for part in re.split(r" && ", line):
                yield words(part)


def words(command):
    """A command's words without what comes before the program's name; the shell's own expansions done."""
    split = subprocess.run(["bash", "-fc", f"printf '%s\\0' {command}"], capture_output=True, text=True, check=True)
    first, *rest = split.stdout.split("\0")[:-1]
    return [{"python3": "python"}.get(Path(first).name, Path(first).name), *rest]


def listed(known, command):
    """The longest entry of a list that a command begins with, or None."""
    begun = [key for key in known if command[: len(key.split())] == key.split() or all_in(key.split(), command)]
    return max(begun, key=len, default=None)


def all_in(key, command):
    """Whether a command is of the entry's kind and has its options with their values, in any place."""
    plain = [i for i, word in enumerate(key) if word.startswith("--")]
    if not plain:
        return False
    head, options = key[: plain[0]], key[plain[0] :]
    pairs = list(itertools.pairwise(command))
    return command[: len(head)] == head and all(p in pairs for p in zip(options[::2], options[1::2], strict=True))


def shortened(command):
    """A command with the smaller values of ``SHORTER``."""
    entry = listed(SHORTER, command)
    assert entry is not None, f"`{shlex.join(command)}` is of a kind that stands in no list of {Path(__file__).name}"
    made = list(command)
    for option, value in SHORTER[entry].items():
        if option in made:
            made[made.index(option) + 1] = value
        else:
            made += [option, value]
    return made


def read(arguments, *table):
    """Whether the command line can read a command, of dcgrid or of another table; nothing is done."""
    try:
        with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
            main.parse(arguments, *table)
    except SystemExit as stopped:
        return stopped.code in (0, None)
    except ValueError:  # there is no such command
        return False
    return True


def check_read(command):
    """Fail unless a command can be read: dcgrid's by its command line, Python's by its module or file being there."""
    if command[0] == "dcgrid":
        # `dcgrid tune`: what it is about
        name_alone = all(re.fullmatch("[a-z]+(-[a-z0-9]+)*", word) for word in command)
        assert read([*command[1:], *["--help"] * name_alone]), f"`{shlex.join(command)}` cannot be read"
    elif command[:3] == STUDIES:
        assert read(command[3:] + ["--help"] * (len(command) <= 4), studies.COMMANDS, studies.PROG), command
    elif command[:2] == ["python", "-m"]:
        in_ci = ELSEWHERE.get(listed(ELSEWHERE, command) or "") == ".ci/run"  # with an extra that tests do without
        assert in_ci or importlib.util.find_spec(command[2]) is not None, command
    elif command[0] in ("python", "bash"):
        assert (ROOT / command[1]).is_file(), command


def run(command, monkeypatch):
    """Run a command in this process."""
    if command[0] == "dcgrid":
        main.main(command[1:])
    elif command[:3] == STUDIES:
        studies.main(command[3:])
    else:
        named = command[3:] if command[1] == "-m" else command[2:]
        monkeypatch.setattr(sys, "argv", [command[2] if command[1] == "-m" else command[1], *named])
        if command[1] == "-m":
            runpy.run_module(command[2], run_name="__main__", alter_sys=False)
        else:
            runpy.run_path(str(ROOT / command[1]), run_name="__main__")


def alike(command):
    """Return a key that is equal for commands which differ only in numbers and folders; one of them is run."""
    kept, skip = [], False
    for word in command:
        if skip or re.fullmatch(r"[-\d.,e]+", word):
            skip = False
            continue
        skip = word in ("--out", "--name")
        kept.append(word)
    return tuple(kept)


READ = {name: Document(name) for name in DOCUMENTS}


def write_toml(folder):
    """The blocks of TOML as files."""
    for name, block in itertools.chain.from_iterable(document.toml.items() for document in READ.values()):
        (folder / name).write_text(block, encoding="utf-8")


def write_files(folder):
    """The blocks that commands name as files, and those that examples make."""
    write_toml(folder)
    named = {found for document in READ.values() for found in SAVED_AS.findall(" ".join(document.lines))}
    for file, member in named:
        blocks = [b for d in READ.values() for b in d.python if re.search(rf"^(class|def) {member}\b", b, re.MULTILINE)]
        if blocks:
            (folder / file).write_text(blocks[0], encoding="utf-8")
    (folder / "docs" / "images").mkdir(parents=True)
    (folder / "results").mkdir()
    for ending in ("safetensors", "json"):  # for those that examples train
        for trained in ("cleanrl", "sb3_plain"):
            shutil.copy(FOLDER / f"ieee33-weak-analytic.{ending}", folder / "results" / f"{trained}.{ending}")


def write_case(folder):
    """A MATPOWER case under the name of the one that docs/own-feeder.md begins with: a feeder that ships, as one."""
    feeder, base_mva = load_feeder("khodr141"), 10.0
    z_ohm = feeder.base_kv**2 / base_mva
    loads = zip(feeder.p_load_kw / 1000.0, feeder.q_load_kvar / 1000.0, strict=True)
    kinds = [3] + [1] * feeder.n_branch
    buses = [
        f"{i + 1} {kind} {p:.9g} {q:.9g} 0 0 1 1 0 {feeder.base_kv} 1 1.1 0.9;"
        for i, (kind, (p, q)) in enumerate(zip(kinds, loads, strict=True))
    ]
    lines = zip(feeder.parent, feeder.r_ohm / z_ohm, feeder.x_ohm / z_ohm, strict=True)
    branches = [
        f"{parent + 1} {k + 2} {r:.9g} {x:.9g} 0 0 0 0 0 0 1 -360 360;" for k, (parent, r, x) in enumerate(lines)
    ]
    text = [
        "function mpc = case118zh", "mpc.version = '2';", f"mpc.baseMVA = {base_mva};",
        "mpc.bus = [", *buses, "];", f"mpc.gen = [1 0 0 99 -99 1 {base_mva} 1 99 0{' 0' * 11}];",
        "mpc.branch = [", *branches, "];",
    ]  # fmt: skip
    (folder / "case118zh.m").write_text("\n".join(text) + "\n", encoding="utf-8")


def test_there_are_documents_with_commands_and_code():
    assert {"README.md", "CONTRIBUTING.md", "traces/README.md", "docs/examples/README.md"} <= set(READ)
    assert sum(len(document.python) for document in READ.values()) >= 7
    assert sum(len(list(document.commands())) for document in READ.values()) >= 30


@pytest.mark.parametrize("name", [name for name, document in READ.items() if document.lines or document.inline])
@pytest.mark.slow
def test_every_command_can_be_read(name):
    for command in (*READ[name].commands(), *map(words, READ[name].inline)):
        check_read(command)


@pytest.mark.parametrize("name", [name for name, document in READ.items() if document.lines])
def test_every_command_is_of_a_kind_that_is_run_here_or_elsewhere(name):
    for command in READ[name].commands():
        if (elsewhere := listed(ELSEWHERE, command)) is not None:
            assert (ROOT / ELSEWHERE[elsewhere]).exists()
        else:
            shortened(command)


@pytest.mark.parametrize("command", ["dcgrid new --episodes 3", "python docs/new.py", "dcgrid train new"])
def test_a_command_of_no_known_kind_fails(command):
    assert listed(ELSEWHERE, words(command)) is None
    with pytest.raises(AssertionError, match="stands in no list"):
        shortened(words(command))


def test_options_of_a_document_stay_but_for_the_smaller_values():
    given = "dcgrid train analytic --scenario ieee33-weak --updates 120 --act q"
    expected = "dcgrid train analytic --scenario ieee33-weak --updates 1 --act q --num-envs 2 --validation-episodes 2"
    assert shortened(words(given)) == expected.split()


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # a user's commands print warnings and go on
@pytest.mark.parametrize("name", [name for name, document in READ.items() if document.lines])
def test_commands_run(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DCGRID_NUM_THREADS", "1")
    write_files(tmp_path)
    write_case(tmp_path)
    done = set()
    for command in READ[name].commands():
        if listed(ELSEWHERE, command) is None and alike(command) not in done:
            there = [word for word in command if not word.startswith("results/train/") or Path(word).exists()]
            run(shortened(there), monkeypatch)  # of several seeds only the first has been trained here
            done.add(alike(command))
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, document in READ.items() if document.python])
def test_python_runs(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    power_w = np.array([800.0, 950.0, 700.0, 820.0])
    np.savetxt("recording.csv", np.column_stack((np.arange(4.0), power_w)), delimiter=",")
    write_toml(tmp_path)
    # Blocks of other frameworks run in test_frameworks.py, where those are installed.
    for i, block in enumerate(b for b in READ[name].python if not re.search(r"^from (ray|torchrl)\b", b, re.MULTILINE)):
        exec(compile(block, f"{name}, block {i}", "exec"), {"__name__": "__main__"})
    if name == "README.md":
        found = re.search(r"^score (\S+) ", capsys.readouterr().out, re.MULTILINE)
        assert found is not None
        assert float(found[1]) > 0.5
    if name == "docs/environments.md":
        printed = capsys.readouterr().out.split()
        assert [round(float(x), 4) for x in printed[:2]] == [0.9131, 202.6771]
