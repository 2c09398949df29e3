"""DistFlow of torch tensors on the CPU by the compiled kernels, with the derivative of the solution.

Several times faster than recording the sweeps of ``prefix``, which is for other devices and other array libraries.
The one module of the physics that imports torch; it is imported when the first tensor arrives.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.torch_threads import rest_of_backward_on
from dcgrid_env.grid.feeder import Feeder
from dcgrid_env.powerflow.balanced.batch import solve_rows
from dcgrid_env.powerflow.balanced.distflow_adjoint import distflow_adjoint
from dcgrid_env.powerflow.solution import Solution


def distflow_tensors(
    feeder: Feeder,
    p_kw: Array,
    q_kvar: Array,
    v0_pu: Array | float | None,
    warm: Array | None,
    tolerance: float,
    max_sweeps: int,
) -> Solution:
    """Solve as ``distflow`` does; second derivatives are unavailable and raise RuntimeError."""
    figures: Any = _DistFlow.apply(p_kw, q_kvar, v0_pu, feeder, warm, tolerance, max_sweeps)
    return Solution(*figures) if feeder.loop_ends is not None else Solution(*figures, restart=figures[3].detach())


class _DistFlow(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        p_kw: Array,
        q_kvar: Array,
        v0_pu: Array,
        feeder: Feeder,
        warm: Array | None,
        *rest: Any,
    ) -> Any:
        loads = (p_kw.detach().numpy(), q_kvar.detach().numpy(), v0_pu.detach().numpy())
        start = None if warm is None else warm.detach().numpy()
        solved = solve_rows("distflow", feeder, *loads, start, *rest)
        if feeder.loop_ends is None:
            solved = solved[:-1]
        tensors = [torch.from_numpy(np.asarray(a)) for a in solved]
        ctx.feeder, ctx.torch_threads = feeder, torch.get_num_threads()
        ctx.save_for_backward(*tensors[:4], tensors[5])
        ctx.mark_non_differentiable(*tensors[5:])
        return tuple(tensors)

    @staticmethod
    def backward(ctx: Any, *weights: Any) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        if torch.is_grad_enabled():  # torch's once_differentiable lets a derivative of 0 pass under constant weights
            raise RuntimeError(
                "the derivative of distflow on CPU tensors has no derivative of its own; leave out create_graph=True"
            )
        rest_of_backward_on(ctx.torch_threads)
        *solved, converged = (a.detach().numpy() for a in ctx.saved_tensors)
        shape, n_row = converged.shape, converged.size

        def rows(values: np.ndarray) -> np.ndarray:
            return values.reshape((n_row, *values.shape[len(shape) :]))

        of_rows = tuple(map(rows, solved)), tuple(rows(w.numpy()) for w in weights[:5]), rows(converged)
        out = distflow_adjoint(ctx.feeder, *of_rows)
        d_p, d_q, d_v0 = (torch.from_numpy(d.reshape((*shape, *d.shape[1:]))) for d in out)
        return d_p, d_q, d_v0, None, None, None, None
