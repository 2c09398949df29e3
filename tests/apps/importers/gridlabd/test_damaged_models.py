"""Damaged models: each is refused in one line that names it, or becomes a circuit; never a traceback."""

import random

import pytest

from dcgrid_env import FeederError
from dcgrid_env.apps.importers.gridlabd.glm_model import Model
from dcgrid_env.apps.importers.gridlabd.glm_reading import circuit_commands
from dcgrid_env.apps.importers.gridlabd.glm_text import GlmFile
from dcgrid_env.apps.importers.import_report import Report
from helpers.fuzzing import ODD, mutated_bytes
from helpers.gridlabd_text import HEAD, VOLTAGES

MORE = [*ODD, "{", "}", ";", "#", '"', "-5j;", "ABCN;", "SWING;", "0;", "-3;", "n1;", "1 ft;"]


@pytest.mark.parametrize("name", VOLTAGES)
def test_damaged_models_are_refused_or_read(name, tmp_path):
    rng, path = random.Random(43), tmp_path / "model.glm"
    text = HEAD + VOLTAGES[name][0]
    for k in range(200):
        damaged = mutated_bytes({"model.glm": text.encode()}, rng)["model.glm"]
        if k % 2:
            words = text.split(" ")
            words[rng.randrange(len(words))] = rng.choice(MORE)
            damaged = " ".join(words).encode()
        path.write_bytes(damaged)
        said, commands = outcome(path)
        assert "\n" not in said
        assert not said or "model" in said
        assert all("\n" not in command for command in commands)


def outcome(path):
    """What the error says, or nothing, and the commands of the circuit."""
    try:
        return "", circuit_commands(Model(GlmFile(path)), Report("model"), path)
    except FeederError as error:
        return str(error), []
