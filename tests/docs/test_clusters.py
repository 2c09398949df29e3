"""The files of docs/clusters.md for one's own cluster, which are not run here, can be read and name what is there."""

import importlib
import json
import re
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest

from helpers.places import ROOT

YAML = ROOT / "docs" / "cluster.yaml"


def test_the_image_copies_what_is_there_and_installs_extras_that_there_are():
    lines = (ROOT / "Dockerfile").read_text().replace("\\\n", " ").splitlines()
    instructions = [line.split() for line in lines if line and not line.startswith("#")]
    assert {first for first, *_ in instructions} == {"FROM", "WORKDIR", "COPY", "RUN"}
    copied = {name for first, *names in instructions if first == "COPY" for name in names[:-1]}
    assert [name for name in copied if not (ROOT / name).exists()] == []
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    folders = {folder.split("/")[0] for folder in project["tool"]["setuptools"]["package-dir"].values()}
    assert folders <= copied
    (extras,) = re.findall(r'"\.\[([\w,-]+)\]"', "\n".join(lines))
    assert set(extras.split(",")) <= set(project["project"]["optional-dependencies"])


def test_the_cluster_file_can_be_read():
    content = importlib.import_module("yaml").safe_load(YAML.read_text())
    assert content["docker"]["image"].startswith("dcgrid")
    assert content["max_workers"] == len(content["provider"]["worker_ips"])
    assert any("--head" in command for command in content["head_start_ray_commands"])


def test_the_cluster_file_fits_rays_own_schema():
    spec = find_spec("ray")
    if spec is None or not spec.submodule_search_locations:
        pytest.skip("the extra ray is not installed")
    schema = json.loads((Path(spec.submodule_search_locations[0]) / "autoscaler" / "ray-schema.json").read_text())
    content = importlib.import_module("yaml").safe_load(YAML.read_text())
    importlib.import_module("jsonschema").validate(content, schema)
