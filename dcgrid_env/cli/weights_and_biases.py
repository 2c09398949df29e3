"""Weights & Biases as a mirror of what a training writes for TensorBoard; nothing of it is needed otherwise."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

PROJECT = "dcgrid"


@contextmanager
def logged(configuration: Any, wanted: bool) -> Iterator[None]:
    """Have what is written for TensorBoard within the block sent to Weights & Biases too, where that is wanted.

    The account, the address and whether to send at all are wandb's own settings (WANDB_MODE=offline keeps it here).
    ValueError where wandb is not installed.
    """
    if not wanted:
        yield
        return
    try:
        wandb = importlib.import_module("wandb")
    except ImportError:
        raise ValueError("wandb is not installed; pip install wandb, or leave --wandb out") from None
    about = {name: str(value) for name, value in dataclasses.asdict(configuration).items()}
    run = wandb.init(project=PROJECT, config=about, sync_tensorboard=True)
    failed = True
    try:
        yield
        failed = False
    finally:
        run.finish(exit_code=int(failed))
