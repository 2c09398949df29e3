"""What is asked of an imported OpenDSS circuit: how far its voltages are from OpenDSS's, and what was reported."""

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
