"""dcgrid benchmark, as a user runs it: resumed, failing, with controllers of the user's own."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from html.parser import HTMLParser

import numpy as np
import pytest

import dcgrid_env.baselines
from dcgrid_env import episode_hash
from dcgrid_env.agents import Network, Policy
from dcgrid_env.agents.controllers import TRAINED
from dcgrid_env.apps.benchmark import benchmark_command, jobs
from dcgrid_env.baselines import CONTROLLERS, TUNED, Droop, Published, make_controller, registry, rollout
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.baselines.score import score
from dcgrid_env.cli.main import main
from dcgrid_env.scenario.presets import make_scenario

OWN = """
import numpy as np

class Still:
    def reset(self, env_info):
        self.n = 2 * env_info.datacenters.count + env_info.inverters.count
        self.steps = 0

    def act(self, observations):
        self.steps += 1
        return np.full((len(observations), self.n), 0.5)

class NotANumber(Still):
    def act(self, observations):
        return super().act(observations) * (np.nan if self.steps > 2 else 1.0)

class WrongShape(Still):
    def act(self, observations):
        return super().act(observations)[:, 1:]

class Raises(Still):
    def act(self, observations):
        raise RuntimeError("out of <b>ideas</b>")

class Refuses(Still):
    def reset(self, env_info):
        raise ValueError("toy6 is beneath me")
"""


@pytest.fixture(autouse=True)
def _known_reference(monkeypatch):
    """Gains of the reference that no later tuning moves, units of two episodes, and hindsight at 0.8 of its J."""

    def make(name, scenario=None, tuned=None):
        return Droop(k_q_mvar_per_pu_s=0.8) if name == "droop-tuned" else make_controller(name, scenario, tuned)

    def values(scenario, folder=None):
        metrics = rollout(scenario, Droop(k_q_mvar_per_pu_s=0.8), range(10)).metrics()
        best = 0.8 * np.array([m["J"] for m in metrics])
        hashes = tuple(episode_hash(scenario, seed) for seed in range(10))
        return Published(np.arange(10), best, 0.9 * best, hashes)

    monkeypatch.setattr(registry, "make_controller", make)
    monkeypatch.setattr(dcgrid_env.baselines, "published", values)
    monkeypatch.setattr(jobs, "UNIT_EPISODES", 2)
    monkeypatch.setattr(benchmark_command, "tuned_from", lambda *_: [])


def benchmark(out, controllers, *more, scenarios="toy6", episodes=5, processes=1):
    arguments = ["--scenarios", scenarios, "--controllers", controllers, "--episodes", str(episodes)]
    main(["benchmark", *arguments, "--out", str(out), "--workers", str(processes), *more])
    return json.loads((out / "results.json").read_text())


@pytest.fixture
def own(tmp_path):
    """A file of controllers in a folder whose name is a trap for HTML and Markdown."""
    path = tmp_path / 'a <i>&"|b' / "own.py"
    path.parent.mkdir()
    path.write_text(OWN)
    return path


@pytest.mark.slow
def test_records_tables_and_report(tmp_path, own, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    results = benchmark(tmp_path / "out", f"none, {own}:Still,none")
    names = ["droop-tuned", "none", f"{own}:Still"]
    keys = [(r["scenario"], r["controller"], r["episode"], r["seed"]) for r in results["episodes"]]
    assert keys == [("toy6", name, i, i) for name in names for i in range(5)]
    scenario = make_scenario("toy6", split="test")
    expected = rollout(scenario, make_controller("none"), range(5)).metrics()
    assert [{k: r[k] for k in expected[0]} for r in results["episodes"] if r["controller"] == "none"] == expected
    assert results["failures"] == []
    meta = results["meta"]
    assert (meta["split"], meta["episodes"], list(meta["scenarios"])) == ("test", 5, ["toy6"])
    assert meta["versions"]["dcgrid-env"]
    j = {name: [r["J"] for r in results["episodes"] if r["controller"] == name] for name in names}
    found = score(j["none"], j["droop-tuned"], 0.8 * np.array(j["droop-tuned"]))
    summary = next(row for row in results["summaries"] if row["controller"] == "none")
    assert summary["score"] == found.score._asdict()
    assert summary["difference"] == found.difference._asdict()
    assert not list((tmp_path / "out").rglob("*.part"))
    printed = capsys.readouterr().out
    assert f"{found.score.value:.3f}" in printed
    _markdown_equals_the_records((tmp_path / "out" / "results.md").read_text(), results)
    _report_is_whole((tmp_path / "out" / "report.html").read_text(), images=3)


def _markdown_equals_the_records(text, results):
    section = text.split("## toy6")[1]
    rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in section.splitlines() if line.startswith("| ")]
    header, rows = [cell.strip() for cell in rows[0]], [[cell.strip() for cell in row] for row in rows[1:]]
    assert len(rows) == 3
    for row in rows:
        name = row[0].replace("\\", "")
        of = [r for r in results["episodes"] if r["controller"].replace("\\", "") == name]
        mean = {key: sum(r[key] for r in of) / len(of) for key in of[0] if key not in ("scenario", "controller")}
        at = dict(zip(header, row, strict=True))
        assert at["J"] == f"{mean['J']:.4f}"
        assert at["mean \\|V-1\\|, p.u."] == f"{mean['voltage_deviation_mean_pu']:.4f}"
        assert at["mean delay, s"] == f"{mean['delay_mean_s']:.2f}"
        assert at["unserved, kW s"] == f"{mean['unserved_kws']:.1f}"
        summary = next(s for s in results["summaries"] if s["controller"] == of[0]["controller"])
        s = summary["score"]
        assert at["score"] == f"{s['value']:.3f} ({s['low']:.3f} to {s['high']:.3f})"


class _Tags(HTMLParser):
    """Tags, open ones, and links of a page."""

    def __init__(self):
        super().__init__()
        self.tags, self.open, self.links = set(), [], []

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.links += [value for name, value in attrs if name in ("src", "href")]
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def _report_is_whole(text, images):
    page = _Tags()
    page.feed(text)
    assert page.open == []
    known = "html head meta title style body h1 h2 nav a div table thead tbody tr th td br small p img"
    assert page.tags <= set(known.split())
    assert "&lt;i&gt;&amp;&quot;|b" in text
    assert "<i>" not in text
    assert all(link.startswith(("data:image/png;base64,", "#")) for link in page.links)
    assert sum(link.startswith("data:") for link in page.links) == images
    assert "http" not in re.sub(r"base64,[^\"]*", "", text)


@pytest.mark.slow
def test_an_interrupted_benchmark_goes_on_and_gives_the_same(tmp_path, capsys, monkeypatch):
    whole = benchmark(tmp_path / "whole", "none,droop")
    real, calls = jobs.run, []

    def run(task):
        calls.append(task)
        if len(calls) == 5:
            raise KeyboardInterrupt
        return real(task)

    out = tmp_path / "out"
    monkeypatch.setattr(jobs, "run", run)
    with pytest.raises(SystemExit) as stopped:
        benchmark(out, "none,droop")
    assert stopped.value.code == 130
    assert "interrupted with 4 of 9 units done" in capsys.readouterr().out.replace("\n", " ")
    assert len(list(out.rglob("units/*/*/*.json"))) == 4
    assert not (out / "results.json").exists()
    resumed = benchmark(out, "none,droop")
    assert "4 of 9 units with these settings are already in" in capsys.readouterr().out.replace("\n", " ")
    assert len(calls) == 5 + 5
    for part in ("episodes", "summaries", "failures"):
        assert resumed[part] == whole[part]
    again = benchmark(out, "droop", episodes=4)
    assert len(calls) == 10
    assert [r for r in whole["episodes"] if r["controller"] == "droop"][:4] == again["episodes"][4:]


@pytest.mark.slow
def test_a_changed_controller_is_computed_anew(tmp_path, own):
    spec = f"{own}:Still"
    before = benchmark(tmp_path / "out", spec, episodes=2)
    own.write_text(OWN.replace("0.5)", "0.25)"))
    after = benchmark(tmp_path / "out", spec, episodes=2)
    assert [r["J"] for r in after["episodes"][:2]] == [r["J"] for r in before["episodes"][:2]]
    assert [r["J"] for r in after["episodes"][2:]] != [r["J"] for r in before["episodes"][2:]]
    assert after["episodes"] == benchmark(tmp_path / "fresh", spec, episodes=2)["episodes"]


@pytest.mark.slow
def test_what_fails_is_reported_and_the_rest_goes_on(tmp_path, own, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    specs = [f"{own}:{name}" for name in ("NotANumber", "WrongShape", "Raises", "Refuses", "Still")]
    results = benchmark(tmp_path / "out", ",".join(specs), episodes=3)
    told = {f["controller"]: f["failure"] for f in results["failures"]}
    assert list(told) == specs[:4]
    assert re.match(r"failed in act: action of dc_0: clock is nan in environment 0", told[specs[0]])
    assert re.match(r"failed in act: the action has shape \(2, 3\); it must be \(2, 4\)", told[specs[1]])
    assert told[specs[2]] == "failed in act, own.py line 23: RuntimeError: out of <b>ideas</b>"
    assert told[specs[3]] == "does not apply: toy6 is beneath me"
    assert {r["controller"] for r in results["episodes"]} == {"droop-tuned", specs[4]}
    printed = capsys.readouterr().out
    markdown = (tmp_path / "out" / "results.md").read_text()
    page = (tmp_path / "out" / "report.html").read_text()
    for name in ("NotANumber", "Raises", "Refuses"):
        assert f":{name}: failed" in printed or f":{name}: does not apply" in printed
        assert f":{name}: " in markdown or f":{name}. Their reasons" in markdown
    assert "out of &lt;b&gt;ideas&lt;/b&gt;" in page
    _report_is_whole(page, images=3)


_of_another_training = (("datacenter", 9, [0.5, 0.2]), ("inverter", 7, [0.2]))


@pytest.mark.slow
def test_a_saved_policy_and_a_module_join(tmp_path, monkeypatch):
    (tmp_path / "joining").mkdir()
    (tmp_path / "joining" / "laws.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])
    half = {"datacenter": Network([(np.zeros((9, 2)), [0.5] * 2)]), "inverter": Network([(np.zeros((7, 1)), [0.5])])}
    Policy(half).save("half")
    Policy(half).save("trained/policy")
    names = ("half.safetensors", "trained", "joining.laws:Still")
    results = benchmark(tmp_path / "out", ",".join(names), episodes=2)
    j = [[r["J"] for r in results["episodes"] if r["controller"] == name] for name in names]
    assert len(j[0]) == 2
    assert j[0] == j[1] == j[2]
    networks = {kind: Network([(np.zeros((n, len(q))), q)]) for kind, n, q in _of_another_training}
    Policy(networks).save("trained/policy")
    again = benchmark(tmp_path / "out", ",".join(names), episodes=2)
    assert [r["J"] for r in again["episodes"] if r["controller"] == "trained"] != j[1]  # not what was kept of the first


@pytest.mark.slow
def test_two_processes_give_what_one_gives(tmp_path, own):
    controllers = f"none,droop,{own}:Still,{own}:Raises"
    one = benchmark(tmp_path / "one", controllers, episodes=4)
    two = benchmark(tmp_path / "two", controllers, episodes=4, processes=2)
    named = ("none", "droop", f"{own}:Still")
    for name in named:  # the reference of this file is a stand-in that other processes do not know
        a, b = ([r for r in results["episodes"] if r["controller"] == name] for results in (one, two))
        assert len(a) == 4
        assert a == b
    assert one["failures"][-1] == two["failures"][-1]


def test_local_and_all():
    from dcgrid_env.apps.benchmark.benchmark_command import _controllers

    toy6 = jobs.Case(ScenarioSpec("toy6"))
    everyone, local = _controllers("all", toy6), _controllers("local", toy6)
    assert everyone[0] == local[0] == "droop-tuned"
    assert set(everyone) == {*CONTROLLERS, *TUNED}
    assert set(_controllers("policies,none", toy6)) == {"droop-tuned", "none", *TRAINED}
    assert {"none", "droop", "volt-var", "constant-q"} <= set(local) <= set(everyone)
    assert _controllers("none, local", toy6).count("none") == 1
    assert toy6.scenario().split == "test"


SCENARIO = """
from dcgrid_env import load_feeder, make_scenario

def make():
    weak = {"datacenters": {"buses": (27, 65, 35)}, "inverters": {"buses": (5, 12, 40, 61)}}
    return make_scenario("ieee33-weak", name="[/]", feeder=load_feeder("das69"), horizon=10, **weak)
"""


@pytest.mark.slow
def test_ones_own_scenario_and_arguments_with_commas(tmp_path, own, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    own.write_text(OWN + "\nclass Share(Still):\n    def __init__(self, a, b=0): ...\n")
    (tmp_path / "mine.py").write_text(SCENARIO)
    spec = f"{own}:Share(1, b=[2, 3])"
    given = {"scenarios": f"{tmp_path}/mine.py:make", "episodes": 2}
    results = benchmark(tmp_path / "[/]", f"none,{spec}", "--set", "background.load_sigma=0.1", **given)
    assert {r["controller"] for r in results["episodes"]} == {"droop-tuned", "none", spec}
    assert list(results["meta"]["scenarios"]) == ["[/]"]
    assert {r["scenario"] for r in results["episodes"]} == {"[/]"}
    assert f"report.html in {tmp_path}/[/]" in capsys.readouterr().out
    assert len(list((tmp_path / "[/]" / "units").glob("*/*/*.json"))) == 3  # no folder between for the name's slash
    again = benchmark(tmp_path / "[/]", f"none,{spec}", "--set", "background.load_sigma=0.1", **given)
    assert again["episodes"] == results["episodes"]
    assert "3 of 3 units with these settings are already in" in capsys.readouterr().out


@pytest.mark.slow
def test_what_a_score_lacks_is_said_beforehand_with_the_commands(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(SCENARIO)
    monkeypatch.setattr(registry, "make_controller", make_controller)
    monkeypatch.setattr(dcgrid_env.baselines, "published", lambda scenario, folder=None: None)
    results = benchmark(tmp_path / "out", "none", scenarios="mine.py:make", episodes=2)
    printed = capsys.readouterr().out
    first, second = (line for line in printed.splitlines() if line.startswith("[/] will have no score: "))
    assert "`dcgrid tune --laws droop --scenarios mine.py:make`" in first
    assert second.endswith("of 2 episodes; compute it with `dcgrid hindsight --scenarios mine.py:make --episodes 2`")
    assert printed.index(first) < printed.index("episodes ")
    assert [f["controller"] for f in results["failures"]] == ["droop-tuned"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scenarios": "toy6,ieee124"}, "no scenario 'ieee124'; did you mean"),
        ({"scenarios": " , "}, "scenarios: must name at least one scenario, or all, got ' , '"),
        ({"controllers": "none,pid"}, "no controller 'pid'; "),
        ({"controllers": ","}, "controllers: must name at least one, got ','"),
        ({"controllers": "nowhere.py:Law"}, "there is no file nowhere.py"),
        ({"controllers": "nowhere.safetensors"}, "there is no file nowhere.safetensors"),
        ({"episodes": 0}, "episodes: must be at least 1, got 0"),
        ({"processes": 0}, "workers: must be at least 1, got 0"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(arguments, message, tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        benchmark(tmp_path / "out", **{"controllers": "none", **arguments})
    _is_one_line(stopped, capsys, message)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_folder_of_another_run_is_refused(tmp_path, capsys):
    main(["run", "--scenario", "toy6", "--controllers", "none", "--episodes", "1", "--out", str(tmp_path)])
    before = (tmp_path / "results.json").read_text()
    capsys.readouterr()
    with pytest.raises(SystemExit) as stopped:
        benchmark(tmp_path, "none")
    _is_one_line(stopped, capsys, "holds the results of another command")
    assert (tmp_path / "results.json").read_text() == before


@pytest.mark.slow
def test_units_of_a_scenario_that_has_changed_are_refused(tmp_path, capsys):
    benchmark(tmp_path, "none", episodes=2)
    capsys.readouterr()
    with pytest.raises(SystemExit) as stopped:
        benchmark(tmp_path, "none", "--set", "background.load_sigma=0.1", episodes=2)
    _is_one_line(stopped, capsys, "is of another toy6, of hash")


def _is_one_line(stopped, capsys, message):
    assert stopped.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith("dcgrid: ")
    assert message in error
    assert len(error.strip().splitlines()) == 1


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="sends a POSIX signal")
def test_ctrl_c_with_two_processes_loses_nothing_that_was_done(tmp_path):
    arguments = [
        "benchmark",
        "--scenarios",
        "ieee123",
        "--controllers",
        "none,droop,droop-q,inverters",
        "--workers",
        "2",
    ]
    command = [sys.executable, "-m", "dcgrid_env.cli.main", *arguments, "--out", str(tmp_path / "out")]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    ) as started:
        until = time.monotonic() + 60.0
        while not list(tmp_path.glob("out/units/ieee123/*/*.json")) and time.monotonic() < until:
            time.sleep(0.02)
        os.killpg(started.pid, signal.SIGINT)
        try:
            said = started.communicate(timeout=60)[0]
        except subprocess.TimeoutExpired:
            os.killpg(started.pid, signal.SIGKILL)
            raise
    assert started.returncode == 130, said
    assert "interrupted with" in said
    assert "Traceback" not in said
    kept = list(tmp_path.rglob("out/units/ieee123/*/*.json"))
    assert kept
    for path in kept:
        assert len(json.loads(path.read_text())["episodes"]) == 25


@pytest.mark.slow
def test_a_line_break_in_the_command_stays_within_its_line_of_the_results(tmp_path):
    out = tmp_path / "line\n# break"
    words = ["benchmark", "--scenarios", "toy6", "--set", "horizon=4", "--controllers", "none", "--episodes", "1"]
    main([*words, "--workers", "1", "--out", str(out)])
    head = (out / "results.md").read_text(encoding="utf-8").split("\n\n")
    assert head[0] == "# dcgrid benchmark"
    assert head[1].startswith("    dcgrid benchmark ")
    assert head[1].endswith("line\\n# break'")
