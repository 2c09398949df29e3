"""DistFlow of torch tensors on the CPU by the compiled kernels, with the derivative of the solution.

Several times faster than recording the sweeps of ``prefix``, which is for other devices and other array libraries.
The one module of the physics that imports torch; it is imported when the first tensor arrives.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.threads import over_rows
from dcgrid_env.core.torch_threads import rest_of_backward_on
from dcgrid_env.grid.feeder import Feeder
from dcgrid_env.powerflow.balanced import adjoint
from dcgrid_env.powerflow.balanced.batch import constants, solve_rows
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
    return Solution(*figures, restart=figures[3].detach())


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
        tensors = [torch.from_numpy(np.asarray(a)) for a in solved[:-1]]
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
        n, dtype, shape = ctx.feeder.n_bus, solved[0].dtype, converged.shape
        n_row = converged.size
        widths = (n, n - 1, n - 1, n - 1, None)
        of_feeder = constants(ctx.feeder, dtype.type)
        g = [_rows(w.numpy(), n_row, width) for w, width in zip(weights, widths, strict=False)]
        s = [_rows(a, n_row, width) for a, width in zip(solved, widths, strict=False)]
        ok = _rows(converged, n_row, None)
        out = (np.empty((n_row, n), dtype), np.empty((n_row, n), dtype), np.empty(n_row, dtype))
        tolerance = adjoint.TOLERANCE[dtype.itemsize]
        kernel: Any = adjoint.distflow_adjoint_rows

        def part(a: int, b: int) -> int:
            cut = slice(a, b)
            solved_part, weights_part, out_part = (tuple(x[cut] for x in arrays) for arrays in (s, g, out))
            kernel(*of_feeder, solved_part, weights_part, ok[cut], tolerance, out_part)
            return 0

        over_rows(part, n_row)
        d_p, d_q = (torch.from_numpy(d.reshape(*shape, n)) for d in out[:2])
        return d_p, d_q, torch.from_numpy(out[2].reshape(shape)), None, None, None, None


def _rows(values: np.ndarray, n_row: int, width: int | None) -> np.ndarray:
    """(row, width) or (row,), contiguous: the one memory layout that the kernel is compiled for."""
    return np.ascontiguousarray(values.reshape((n_row,) if width is None else (n_row, width)))
