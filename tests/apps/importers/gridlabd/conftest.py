"""A fixture that writes a model into a temporary folder."""

import pytest

from helpers.gridlabd_text import HEAD


@pytest.fixture
def model(tmp_path):
    """Writes a model file: the head, if not left out, and further lines."""

    def write(more="", head=HEAD):
        path = tmp_path / "model.glm"
        path.write_text(head + more)
        return path

    return write
