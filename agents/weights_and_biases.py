"""Send the TensorBoard logs of a training to Weights & Biases, an optional package."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

PROJECT = "dcgrid"


@contextmanager
def logged(configuration: Any, wanted: bool) -> Iterator[None]:
    """Send TensorBoard logs within the block to Weights & Biases if ``wanted`` is set.

    wandb's settings define the account and the address (WANDB_MODE=offline stores the logs on this machine). Raises
    ValueError if wandb is not installed.
    """
    if not wanted:
        yield
        return
    try:
        wandb = importlib.import_module("wandb")
    except ImportError:
        raise ValueError("wandb: package is not installed; run pip install wandb, or remove --wandb") from None
    about = {name: str(value) for name, value in dataclasses.asdict(configuration).items()}
    run = wandb.init(project=PROJECT, config=about, sync_tensorboard=True)
    failed = True
    try:
        yield
        failed = False
    finally:
        run.finish(exit_code=int(failed))
