"""Checks of an imported OpenDSS circuit: voltages against those of OpenDSS, and the report."""

import numpy as np

from dcgrid_env import ThreePhaseFeeder
from dcgrid_env.powerflow import solve_unbalanced


def voltages(feeder):
    solution = solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    assert solution.converged
    return dict(zip(feeder.node_ids, solution.v_re_pu + 1j * solution.v_im_pu, strict=True))


def apart_pu(found):
    """Largest difference between our voltages and OpenDSS's, p.u., over the nodes that both have."""
    ours = voltages(ThreePhaseFeeder.from_network(found.network))
    assert found.v_pu
    return max(abs(ours[node] - v) for node, v in found.v_pu.items())


def fates(found):
    return {(row.kind, name, row.fate) for row in found.findings for name in row.names}


def by_opendss(path, factors, read):
    """What ``read`` takes of OpenDSS's engine at the end of each second, the loads multiplied by factors."""
    from opendssdirect import dss

    engine = dss.NewContext()
    engine.Text.Command(f'redirect "{path}"')
    engine.Text.Command("set mode=duty stepsize=1s number=1 controlmode=time maxcontroliter=100")
    found = []
    for factor in factors:
        engine.Text.Command(f"set loadmult={factor}")
        engine.Solution.Solve()
        found.append(read(engine))
    return np.array(found)
