"""Addresses of Ray clusters, and what is said where none can be reached."""

import importlib

import pytest

from dcgrid_env.cli.main import main
from dcgrid_env.core.work.cluster import cluster


@pytest.mark.parametrize("address", ["", "nowhere", "http://a:1", "ray://a", "a:0", "a:70000", "ray://:10001"])
def test_an_address_of_no_known_form_is_refused(address):
    with pytest.raises(ValueError, match="give auto, HOST:PORT, or ray://HOST:PORT"):
        cluster(address)


def stopped(capsys, *words):
    with pytest.raises(SystemExit) as ended:
        main(list(words))
    error = capsys.readouterr().err
    assert ended.value.code == 2
    assert len(error.splitlines()) == 1
    return error


def test_where_nobody_listens_is_one_line(tmp_path, capsys):
    words = ["benchmark", "--scenarios", "toy6", "--episodes", "1", "--out", str(tmp_path / "out")]
    error = stopped(capsys, *words, "--ray", "127.0.0.1:9")
    assert error.startswith("dcgrid: ray: no cluster could be reached at '127.0.0.1:9' (")
    assert not (tmp_path / "out").exists()


def test_without_ray_it_is_said_how_to_install_it(monkeypatch):
    def missing(name):
        raise ImportError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(ValueError, match=r"^ray: No module named 'ray'; install it in a clone .*\[ray\]"):
        cluster("auto")


def test_a_cluster_and_workers_of_this_machine_are_not_both_given(capsys):
    error = stopped(capsys, "tune", "--scenarios", "toy6", "--workers", "2", "--ray", "auto")
    assert "workers: must not be combined with --ray" in error
    error = stopped(capsys, "train", "analytic", "--ray", "auto")
    assert error.startswith("dcgrid: seeds: must be given with --workers or --ray")
