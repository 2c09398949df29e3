"""The command that times the generators: its lines, not its figures."""

import re

from dcgrid_env.traces import timing


def test_a_line_for_each_thing_that_is_timed(capsys):
    timing.main(hours=0.05, sources=("step",))
    chat, code, site, step = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"requests\('chat', hours=0\.05\): [\d,]+ requests, \d+\.\d\d s", chat)
    assert re.fullmatch(r"requests\('code', hours=0\.05\): [\d,]+ requests, \d+\.\d\d s", code)
    assert re.match(r"0\.05 h of a 279 kW site that answers \d+ chat requests a second: \d+\.\d s; held ", site)
    assert re.fullmatch(r"library\('step'\), 24 rows of an hour, once a process: \d+\.\d s", step)
