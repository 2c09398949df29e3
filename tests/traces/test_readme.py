"""The tables of traces/README.md equal the output of their commands."""

import re

import numpy as np
import pytest

from docs.studies.traces import compared_tasks, generated_inference, generated_power, generated_requests
from helpers.places import GPU_RECORDING, ROOT, SHARED_TRACES, require

README = ROOT / "traces" / "README.md"


def rows(text):
    """Label and numbers of each row of a Markdown table, in order."""
    found = []
    for line in text.splitlines():
        cells = line.split("|")[1:-1]
        numbers = [float(x) for x in re.findall(r"-?\d+\.?\d*", "".join(cells[1:]))]
        if numbers and "---" not in line:
            found.append((cells[0].strip(), numbers))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("command", ["recording", "power", "requests", "tasks"])
def test_tables_are_what_the_command_prints(command, capsys):
    if command == "recording":
        generated_inference.main([str(require(GPU_RECORDING))])
    elif command == "power":
        logs = {"chat": "azure_2023_conversation.csv", "code": "azure_2023_code.csv"}
        files = {"inference": GPU_RECORDING} | {service: SHARED_TRACES / name for service, name in logs.items()}
        generated_power.main([f"{source}={require(file)}" for source, file in files.items()])
    elif command == "requests":
        generated_requests.main([])
    else:
        compared_tasks.main()
    printed, written = rows(capsys.readouterr().out), rows(README.read_text(encoding="utf-8"))
    assert len(printed) >= 8
    for label, numbers in printed:
        candidates = [other for name, other in written if name == label and len(other) == len(numbers)]
        # Half a digit, and a little for another machine's last bits.
        assert any(np.allclose(numbers, other, rtol=0.01, atol=0.002) for other in candidates), (label, numbers)
