"""Documents show the command that made a result."""

import shlex

from dcgrid_env.core.versions import code_block, command_of, meta


def test_a_command_is_one_line_of_code_whatever_its_words_hold():
    with command_of(["dcgrid", "benchmark", "--out", "a\n# title\r\x1b[2J\u2028é"]):
        command = meta()["command"]
    assert shlex.split(command)[-1] == "a\n# title\r\x1b[2J\u2028é"  # the record keeps it as it was
    assert code_block(command) == "    dcgrid benchmark --out 'a\\n# title\\r\\x1b[2J\\u2028é'"
