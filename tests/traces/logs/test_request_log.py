"""Request logs in Azure's format: the published ones, where they are, and the errors that name the line."""

import gzip
import hashlib
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcgrid_env.traces import TraceError
from dcgrid_env.traces.logs.request_log import read_request_log
from dcgrid_env.traces.text import text_file
from helpers.places import SHARED_TRACES, require

HEADER = "TIMESTAMP,ContextTokens,GeneratedTokens\n"
TWO = "2023-11-16 18:15:46.6805900,374,44\n2023-11-16 18:15:50.9951690,396,109\n"


@pytest.mark.parametrize(
    ("name", "sha256", "n", "rate", "variation", "context", "generated"),
    [
        (
            "azure_2023_conversation.csv",
            "2f1e5b666d4e3055fdbba98598ce2ec307767b9064e03e2fa46676dbcc7d0bf8",
            19_366,
            5.53,
            1.09,
            (1020, 2734, 4142),
            (129, 424, 601),
        ),
        (
            "azure_2023_code.csv",
            "54e9a6d2a4bd06ba1e060304b900abbc74cbea53de96506e60fe5bb4f2277fb6",
            8_819,
            2.57,
            13.2,
            (1469, 5186, 7436),
            (13, 55, 249),
        ),
    ],
)
def test_the_published_logs(name, sha256, n, rate, variation, context, generated):
    requests = read_request_log(require(SHARED_TRACES / name))
    assert (len(requests), requests.provenance.sha256) == (n, sha256)
    assert requests.duration_s == requests.arrival_s[-1]
    assert n / requests.duration_s == pytest.approx(rate, abs=0.005)
    between_s = np.diff(requests.arrival_s)
    assert between_s.std() / between_s.mean() == pytest.approx(variation, rel=0.005)
    # The lower of the two values around a quantile; the published 249 lies between two as well.
    for tokens, published in ((requests.context_tokens, context), (requests.generated_tokens, generated)):
        np.testing.assert_allclose(np.quantile(tokens, [0.5, 0.9, 0.99], method="lower"), published, rtol=0.005)


@pytest.fixture
def write(tmp_path):
    def write_text(text, name="requests.csv"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write_text


def test_times_count_from_the_first_request(write):
    path = write(HEADER + TWO)
    requests = read_request_log(path)
    np.testing.assert_allclose(requests.arrival_s, [0.0, 4.314579], atol=1e-12)
    assert requests.context_tokens.tolist() == [374, 396]
    assert requests.generated_tokens.tolist() == [44, 109]
    assert requests.duration_s == requests.arrival_s[-1]
    assert (requests.name, requests.provenance.name) == ("requests", "requests.csv")
    assert requests.provenance.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert read_request_log(path, name="chat").name == "chat"


def test_forms_of_time_of_2024(write):
    text = "2024-05-10T00:00:00Z,1,2\n2024-05-10 00:00:00.009930+00:00 , 3, 4\n\n2024-05-10 00:00:01+00:00,5,6\n"
    requests = read_request_log(write("# week 2\n" + HEADER + text))
    np.testing.assert_allclose(requests.arrival_s, [0.0, 0.00993, 1.0], atol=1e-12)


def test_gzip(tmp_path):
    path = tmp_path / "azure.csv.gz"
    path.write_bytes(gzip.compress((HEADER + TWO).encode()))
    requests = read_request_log(path)
    assert (len(requests), requests.name) == (2, "azure")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"requests.csv: is empty; give a log with the header TIMESTAMP,ContextTokens,GeneratedTokens"),
        (HEADER, r"requests.csv: has 0 requests, none after the first time"),
        (HEADER + TWO.split("\n")[0], r"has 1 requests"),
        (TWO, r"line 1: is '2023-11-16 18:15:46.6805900,374,44' instead of the header TIMESTAMP"),
        ("TIMESTAMP,Context\n" + TWO, r"requests.csv, line 1: is 'TIMESTAMP,Context' instead of the header"),
        (HEADER + TWO + TWO, r"line 4: 2023-11-16 18:15:46.6805900 comes before .*; sort the requests"),
        (HEADER + TWO + "\n1,2\n", r"line 5: has 2 cells, not 3"),
        (HEADER + TWO + "yesterday,1,2\n", r"line 4: TIMESTAMP is 'yesterday'; write times in UTC like"),
        (HEADER + TWO + "2023-11-16 18:15:51+01:00,1,2\n", r"line 4: TIMESTAMP is '2023-11-16 18:15:51\+01:00'"),
        (HEADER + TWO + "2023-11-31 18:15:51,1,2\n", r"line 4: there is no time '2023-11-31 18:15:51'"),
        (HEADER + TWO + "2023-11-16 18:15:51,1.5,2\n", r"line 4: ContextTokens is '1.5'; give a whole number"),
        (HEADER + TWO + "2023-11-16 18:15:51,1,\n", r"line 4: GeneratedTokens is ''; give a whole number"),
        (HEADER + TWO + "2023-11-16 18:15:51,0,2\n", r"line 4: ContextTokens is '0'; .*remove the request"),
        (HEADER + TWO + "2023-11-16 18:15:51,1,0\n", r"line 4: GeneratedTokens is '0'"),
        (HEADER + TWO + "2023-11-16 18:15:51,1,-2\n", r"line 4: GeneratedTokens is '-2'"),
        (
            HEADER + TWO + "2023-11-16 18:15:51,1,100001\n",
            r"line 4: GeneratedTokens is '100001'; .* from 1 to 100000, or",
        ),
        (
            HEADER + TWO + "\n2023-11-16 18:15:51,10000001,1\n",
            r"line 5: ContextTokens is '10000001'; .* 1 to 10000000,",
        ),
        (HEADER + TWO + f"2023-11-16 18:15:51,{10**12},1\n", r"line 4: ContextTokens is '10+'; .* 1 to 10000000, or"),
    ],
)
@pytest.mark.parametrize("block_chars", [1, 1 << 22])
def test_bad_logs_are_named(write, text, message, block_chars):
    with mock.patch.object(text_file, "BLOCK_CHARS", block_chars), pytest.raises(TraceError, match=message):
        read_request_log(write(text))


REQUESTS = st.tuples(st.integers(0, 10**10), st.integers(1, 10**7), st.integers(1, 10**5))


@given(st.lists(REQUESTS, min_size=1, max_size=20), st.sampled_from([1, 50, 1 << 22]))
def test_what_is_written_is_read_whatever_the_block(tmp_path_factory, rows, block_chars):
    ticks = np.cumsum([0, *(step for step, _, _ in rows), 1])
    tokens = np.array([(1, 1), *((c, g) for _, c, g in rows), (1, 1)])
    # Ticks of 100 ns, the seven decimals of the release of 2023.
    times = np.datetime64("2023-11-16 18:15:46.6805900", "ns") + ticks * np.timedelta64(100, "ns")
    lines = [f"{str(time)[:-2].replace('T', ' ')},{c},{g}\n" for time, (c, g) in zip(times, tokens, strict=True)]
    path = tmp_path_factory.mktemp("logs") / "requests.csv"
    path.write_text(HEADER + "".join(lines), encoding="utf-8")
    with mock.patch.object(text_file, "BLOCK_CHARS", block_chars):
        requests = read_request_log(path)
    np.testing.assert_array_equal(requests.arrival_s, ticks * 100 / 1e9)
    np.testing.assert_array_equal(np.column_stack([requests.context_tokens, requests.generated_tokens]), tokens)


BURST = """\
Timestamp,Model,Request tokens,Response tokens,Total tokens,Log Type
5,ChatGPT,472,18,490,Conversation log
45,ChatGPT,1087,0,1087,Conversation log
118,GPT-4,417,276,693,API log
118.5,GPT-4,417,27,444,API log
"""
BURST_SESSIONS = """\
Timestamp,Session ID,Elapsed time,Model,Request tokens,Response tokens,Total tokens,Log Type
5.0,,1.5,ChatGPT,472,18,490,API log
118.0,7,2,GPT-4,417,276,693,Conversation log
"""
MOONCAKE = "".join(
    f'{{"timestamp": {ms}, "input_length": {read}, "output_length": {written}, "hash_ids": [0, 1]}}\n'
    for ms, read, written in ((0, 6758, 500), (0, 7322, 490), (3000, 13544, 71))
)


@pytest.mark.parametrize(
    ("text", "arrival_s", "context", "generated", "failed"),
    [
        (BURST, [0, 113, 113.5], [472, 417, 417], [18, 276, 27], 1),
        (BURST_SESSIONS, [0, 113], [472, 417], [18, 276], 0),
        (MOONCAKE, [0, 0, 3], [6758, 7322, 13544], [500, 490, 71], None),
    ],
)
@pytest.mark.parametrize("block_chars", [1, 1 << 22])
def test_logs_of_burstgpt_and_mooncake(write, text, arrival_s, context, generated, failed, block_chars):
    with mock.patch.object(text_file, "BLOCK_CHARS", block_chars):
        requests = read_request_log(write(text))
    assert requests.arrival_s.tolist() == arrival_s
    assert requests.context_tokens.tolist() == context
    assert requests.generated_tokens.tolist() == generated
    assert requests.provenance.parameters.get("without_response") == failed


def test_a_part_of_a_log_has_times_from_its_beginning(write):
    requests = read_request_log(write(BURST), part_s=(100.0, 113.5))
    assert (requests.arrival_s.tolist(), requests.duration_s) == ([13.0], 13.5)
    assert requests.provenance.parameters["part_s"] == [100.0, 113.5]
    whole = read_request_log(write(HEADER + TWO), part_s=(0.0, 60.0))
    np.testing.assert_allclose(whole.arrival_s, [0.0, 4.314579], atol=1e-12)
    assert whole.provenance.sha256 == hashlib.sha256((HEADER + TWO).encode()).hexdigest()


@pytest.mark.parametrize(
    ("text", "part_s", "message"),
    [
        (BURST.replace("472,", "many,"), None, r"line 2: Request tokens is 'many'; give a whole number"),
        (BURST.replace("\n5,", "\nnoon,"), None, r"line 2: Timestamp is 'noon'; write times in s from the beginning"),
        (BURST.replace("118,", "1,"), None, r"line 4: 1 comes before the time of the request above"),
        (BURST + "1,2\n", None, r"line 6: has 2 cells, not 6"),
        (MOONCAKE + "no\n", None, r"line 4: 'no' is not a JSON object"),
        (MOONCAKE + '{"timestamp": 1}\n', None, r"line 4: input_length is 'None'; give a whole number"),
        (MOONCAKE.replace("71", "0"), None, r"line 3: output_length is '0'; give a whole number"),
        (BURST, (5.0, 1.0), r"part_s = \(5.0, 1.0\) is not a begin and a later end"),
        (BURST, (500.0, 600.0), r"has 0 requests from 500 to 600 s"),
    ],
)
def test_bad_logs_of_burstgpt_and_mooncake_are_named(write, text, part_s, message):
    with pytest.raises(TraceError, match=message):
        read_request_log(write(text), part_s=part_s)
