"""Dialects of tables: all give the cells of the plain file, and doubtful numbers are refused."""

import csv
import io
from unittest import mock

import numpy as np
import pytest

from dcgrid_env.traces import TraceError, read_gpu_log, read_profiles, recorded_trace
from dcgrid_env.traces.text import text_file
from dcgrid_env.traces.text.table_file import open_table

ROWS = [
    ["Time", "site [kW]", "note"],
    *[[f"2026-03-01 12:00:{k:02d}", f"{300 + 0.5 * (k % 4):g}", "a, b" if k % 2 else "c"] for k in range(20)],
]


def written(rows, delimiter=",", decimal=".", quoted=False, end="\n"):
    """The rows as a spreadsheet writes them."""
    out, quoting = io.StringIO(), csv.QUOTE_ALL if quoted else csv.QUOTE_MINIMAL
    writer = csv.writer(out, delimiter=delimiter, quoting=quoting, lineterminator=end)
    writer.writerow(rows[0])
    writer.writerows([row[0], *(cell.replace(".", decimal) for cell in row[1:])] for row in rows[1:])
    return out.getvalue()


DIALECTS = {
    "quotes around every cell": written(ROWS, quoted=True),
    "semicolons": written(ROWS, ";"),
    "semicolons and decimal commas": written(ROWS, ";", ","),
    "semicolons, decimal commas and quotes": written(ROWS, ";", ",", True, "\r\n"),
    "tabs": written(ROWS, "\t"),
    "tabs and decimal commas": written(ROWS, "\t", ","),
    "a line that names the delimiter": "sep=;\n" + written(ROWS, ";", ","),
    "a byte order mark": "\ufeff" + written(ROWS, quoted=True, end="\r\n"),
    "a comment": "# by hand; with a semicolon\n" + written(ROWS, ";", ","),
    "day first": written([ROWS[0], *[[f"01.03.2026 12:00:{r[0][-2:]}", *r[1:]] for r in ROWS[1:]]], ";", ","),
}


@pytest.mark.parametrize("block_chars", [1, 1 << 22])
@pytest.mark.parametrize("dialect", DIALECTS)
def test_every_dialect_gives_the_same_trace(tmp_path, dialect, block_chars):
    path = tmp_path / "site.csv"
    path.write_text(DIALECTS[dialect], encoding="utf-8", newline="")
    with mock.patch.object(text_file, "BLOCK_CHARS", block_chars):
        trace = recorded_trace(str(path))
    # The column of notes is left out: texts that alternate would be two meters.
    np.testing.assert_array_equal(trace.time_s, np.arange(20.0))
    np.testing.assert_array_equal(trace.power_kw, 300 + 0.5 * (np.arange(20) % 4))
    assert trace.began == "2026-03-01T12:00:00.000"


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("quoted", [False, True])
def test_logs_of_nvidia_smi_and_load_profiles_in_every_dialect(tmp_path, delimiter, quoted):
    path = tmp_path / "gpu.csv"
    times = [f"2026/03/01 12:00:{k:02d}.000" for k in range(3)]
    path.write_text(
        written([["timestamp", "power.draw [W]"], *[[t, "70.5 W"] for t in times]], delimiter, quoted=quoted)
    )
    np.testing.assert_allclose(read_gpu_log(path).power_kw, 0.0705)
    decimal = "." if delimiter == "," else ","
    rows = [["time", "701.1", "b"], *[[f"05.03.2026 00:{m}", "0.6", "1.25"] for m in ("00", "15", "30")]]
    path.write_text(written(rows, delimiter, decimal, quoted))
    table = read_profiles(path)
    assert (table.names, table.values.tolist()) == (("701.1", "b"), [[0.6, 1.25]] * 3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t_s;kw\n0;1,5\n1;2.5\n", r"line 3: the column has '2.5' in line 3 and '1,5' in line 2; write all numbers"),
        ("t_s;kw\n0;999\n1;1,250\n", r"line 3: the sign in '1,250' may be a decimal sign or separate thousands"),
        ("t_s;kw\n0;1,5\n1.000;2,5\n", r"line 3: the sign in '1.000' may be a decimal sign or separate thousands"),
        ("t_s;w\n0;950\n1;1.050\n2;980\n", r"line 3: the sign in '1.050' may be a decimal sign or separate thousands"),
        ("t_s;w\n" + "".join(f"{k};950\n" for k in range(90)) + "90;1.050\n", r"line 92: the sign in '1.050' may be"),
        ("t_s;kw\n0;1.234,5\n1;1.235,5\n", r"line 2: .*is '1.234,5', not a number; write numbers with a decimal point"),
        ('t_s,kw\n0,"1,250"\n1,"1,260"\n', r"line 2: .*is '1,250', not a number; write numbers with a decimal point"),
    ],
)
def test_doubtful_numbers_are_refused(tmp_path, text, message):
    path = tmp_path / "site.csv"
    path.write_text(text)
    with pytest.raises(TraceError, match=message):
        recorded_trace(str(path))


@pytest.mark.parametrize(
    ("text", "power_kw"),
    [
        ("t_s;kw\n0;1,250\n1;0,750\n", [1.25, 0.75]),  # no thousands begin with 0
        ("t_s;kw\n0;999\n1;1,25\n", [999.0, 1.25]),
        ("0;1,5\n1;2,5\n", [1.5, 2.5]),
        ("t_s;kw\n0;0\n1;1.050\n2;0.750\n", [0.0, 1.05, 0.75]),
        ("t_s;kw\n0;950\n1;1.050\n2;980.5\n", [950.0, 1.05, 980.5]),
        ("0.5\t1\n1.5\t2\n", [0.001, 0.002]),
    ],
)
def test_numbers_that_are_certain(tmp_path, text, power_kw):
    path = tmp_path / "site.csv"
    path.write_text(text)
    trace = recorded_trace(str(path))
    np.testing.assert_allclose(trace.power_kw / (1e-3 if trace.power_kw[0] == 0.0015 else 1.0), power_kw)


def test_lines_keep_their_numbers(tmp_path):
    path = tmp_path / "site.csv"
    path.write_text('# note\n\nt_s;a_kw;name\n0;1,5;"x, y"\n\n1;2,5;z\n')
    with open_table(path) as file:
        lines = [(file.line, line) for line in iter(file.readline, "")]
    assert lines == [
        (1, "# note\n"), (2, "\n"), (3, "t_s,a_kw,name\n"), (4, '0,1.5,"x, y"\n'), (5, "\n"), (6, "1,2.5,z\n"),
    ]  # fmt: skip
