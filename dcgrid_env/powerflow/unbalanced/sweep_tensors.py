"""The sweep of torch tensors on the CPU by the compiled kernels, with the derivative of the solution.

It is imported when the first tensor arrives; ``array_form`` is for other devices and other array libraries.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.torch_threads import rest_of_backward_on
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.powerflow.unbalanced.adjoint_batch import derivatives
from dcgrid_env.powerflow.unbalanced.sweep_batch import solve_batch
from dcgrid_env.powerflow.unbalanced.three_phase_solution import ThreePhaseSolution


def sweep_tensors(
    feeder: ThreePhaseFeeder, inputs: tuple[Any, ...], start: Array | None, tolerance_pu: float, max_sweeps: int
) -> ThreePhaseSolution:
    """Solve as ``solve_batch`` does; second derivatives are unavailable and raise RuntimeError."""
    volts, amperes, *rest = _Sweep.apply(*inputs, feeder, start, tolerance_pu, max_sweeps)  # pyright: ignore
    v_pu, loss, p, q, converged, iterations, residual = rest
    n = feeder.n_node
    parts = (volts[..., :n], volts[..., n : 2 * n], amperes[..., :n], amperes[..., n:])
    return ThreePhaseSolution(v_pu, *parts, loss, p, q, converged, iterations, residual, restart=volts.detach())


class _Sweep(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Any:
        *tensor_inputs, feeder, start, tolerance_pu, max_sweeps = inputs
        arrays = tuple(a.detach().numpy() for a in tensor_inputs)
        start = None if start is None else start.detach().numpy()
        s = solve_batch(feeder, arrays, start, tolerance_pu, max_sweeps)
        amperes = np.concatenate((s.i_re_a, s.i_im_a), axis=-1)
        figures = (s.restart, amperes, s.v_pu, s.loss_kw, s.source_p_kw, s.source_q_kvar)
        tensors = [torch.from_numpy(np.asarray(a)) for a in (*figures, s.converged, s.iterations, s.residual_kva)]
        ctx.feeder, ctx.torch_threads = feeder, torch.get_num_threads()
        ctx.save_for_backward(*tensor_inputs, tensors[0], tensors[1], tensors[6])
        ctx.set_materialize_grads(False)
        ctx.mark_non_differentiable(*tensors[6:])
        return tuple(tensors)

    @staticmethod
    def backward(ctx: Any, *weights: Any) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        if torch.is_grad_enabled():
            raise RuntimeError(
                "the derivative of the sweep on CPU tensors has no derivative of its own; leave out create_graph=True"
            )
        rest_of_backward_on(ctx.torch_threads)
        *saved_inputs, volts, amperes, converged = (a.detach().numpy() for a in ctx.saved_tensors)
        of_volts, of_amperes, of_magnitude, *of_row = (None if w is None else w.numpy() for w in weights[:6])
        weights = (of_magnitude, of_volts, of_amperes, of_row)
        slopes = derivatives(ctx.feeder, tuple(saved_inputs), (volts, amperes), weights, converged)
        dtype = ctx.saved_tensors[0].dtype
        return *(torch.from_numpy(d).to(dtype) for d in slopes), None, None, None, None
