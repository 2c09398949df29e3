"""Where the repository's files are, and the published data beside it, which are not shipped."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
SHARED_FEEDERS = ROOT.parent / "shared" / "feeders"
SHARED_THREE_PHASE = ROOT.parent / "shared" / "feeders3"
SHARED_CIRCUITS = ROOT.parent / "shared" / "circuits"
SHARED_TRACES = ROOT.parent / "shared" / "traces"
GPU_RECORDING = SHARED_TRACES / "chen_zhang_2025_gpu_inference.csv"

PAPER_SOURCE = ROOT.parent / "shared" / "paper" / "chen-zhang-2025.tex"


def lacks(path):
    """Why a test that needs a published file or folder is skipped."""
    return f"{path.name} is not in {path.parent.relative_to(ROOT.parent)} beside the checkout"


def require(path):
    """Skip the test that calls this where a published file or folder is not there; the path."""
    if not path.exists():
        pytest.skip(lacks(path))
    return path


needs_gpu_recording = pytest.mark.skipif(not GPU_RECORDING.exists(), reason=lacks(GPU_RECORDING))
needs_paper_source = pytest.mark.skipif(not PAPER_SOURCE.exists(), reason=lacks(PAPER_SOURCE))
