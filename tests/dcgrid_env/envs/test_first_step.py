"""What a single environment compiles: nothing for batches, and one version of each kernel."""

import subprocess
import sys

import pytest

CODE = """
import sys
import dcgrid_env
from dcgrid_env.devices import converter
from dcgrid_env.engine.physics import grid_pass
from dcgrid_env.powerflow.balanced import compiled_blocks
from dcgrid_env.powerflow.unbalanced import sweep_adjoint, sweep_rows

env = dcgrid_env.DcgridEnv(sys.argv[1])
env.reset(seed=0)
env.step(env.action_space.sample())
for kernel in (
    grid_pass._few_rows, compiled_blocks.distflow_blocks, grid_pass._many_rows, sweep_rows.sweep_rows,
    sweep_rows.sweep_blocks, sweep_adjoint.sweep_adjoint_rows, converter.dispatch.kernel,
):
    if kernel.signatures:
        print(kernel.__name__, len(kernel.signatures))
"""


@pytest.mark.parametrize(
    ("preset", "compiled"),
    [
        ("ieee33-weak", {"_few_rows": 1, "dispatch_rows": 1}),
        ("ieee34-3ph", {"sweep_rows": 1, "sweep_adjoint_rows": 1, "dispatch_rows": 1}),
    ],
)
@pytest.mark.slow
def test_a_single_environment_compiles_no_kernel_for_batches(preset, compiled):
    done = subprocess.run([sys.executable, "-c", CODE, preset], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert {line.split()[0]: int(line.split()[1]) for line in done.stdout.splitlines()} == compiled
