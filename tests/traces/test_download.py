"""Downloads against a server on this machine: whole, broken off, resumed, wrong, refused, and offline."""

import hashlib
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from dcgrid_env.traces import TraceError
from dcgrid_env.traces.download import download

CONTENT = b"".join(b"%d,%d\n" % (i, i * i % 97) for i in range(20_000))
SHA256 = hashlib.sha256(CONTENT).hexdigest()
CUT = 68 * 1024
"""Bytes after which the server hangs up in the tests of broken connections."""


class Handler(BaseHTTPRequestHandler):
    """Serves `server.content` according to `server.mode`, and notes what was asked and how much was sent."""

    def do_GET(self):
        server: Any = self.server
        asked = self.headers.get("Range")
        server.ranges.append(asked)
        body = server.content
        start = int(asked.removeprefix("bytes=").removesuffix("-")) if asked and server.mode != "no ranges" else 0
        if server.mode == "missing":
            return self.send_error(404)
        if start >= len(body):
            self.send_response(416)
            self.send_header("Content-Range", f"bytes */{len(body)}")
            self.send_header("Content-Length", "0")
            return self.end_headers()
        self.send_response(206 if start else 200)
        if start:
            first = start + 1 if server.mode == "shifted" else start
            self.send_header("Content-Range", f"bytes {first}-{len(body) - 1}/{len(body)}")
        if server.mode != "closes, untold length":
            self.send_header("Content-Length", str(len(body) - start))
        self.end_headers()
        body = body[start:CUT] if server.mode.startswith("closes") else body[start:]
        if server.mode == "slow":
            time.sleep(0.2)
        server.sent.append(len(body))
        self.wfile.write(body)

    def log_message(self, format, *args):
        pass


class Server(ThreadingHTTPServer):
    daemon_threads = False  # so that server_close waits for them

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.content, self.mode, self.ranges, self.sent = CONTENT, "good", [], []
        self.url = f"http://127.0.0.1:{self.server_address[1]}/data.csv"

    def handle_error(self, request, client_address):
        """A client that hangs up is part of the tests."""


@contextmanager
def serving():
    with Server() as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


@pytest.fixture(autouse=True)
def no_proxy(monkeypatch):
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")


@pytest.fixture
def server():
    with serving() as server:
        yield server


@pytest.fixture
def path(tmp_path):
    return tmp_path / "cache" / "data.csv"


@pytest.fixture
def part(path):
    return path.with_name("data.csv.part")


def get(server, path, **options):
    return download(server.url, SHA256, len(CONTENT), path, **options)


def left(path):
    return {p.name for p in path.parent.iterdir()} if path.parent.exists() else set()


def test_a_good_file_comes_whole_and_is_reported(server, path, capfd):
    steps = []
    assert get(server, path, progress=lambda have, size: steps.append((have, size))) == path
    assert path.read_bytes() == CONTENT
    assert left(path) == {"data.csv"}
    assert steps == sorted(steps)
    assert steps[-1] == (len(CONTENT), len(CONTENT))
    assert capfd.readouterr() == ("", "")


def test_a_file_that_is_here_needs_no_server(path):
    with serving() as server:
        get(server, path)
    assert get(server, path) == path  # the server is gone
    assert server.ranges == [None]


def test_a_file_put_there_by_hand_is_checked_and_used(server, path):
    path.parent.mkdir()
    path.write_bytes(CONTENT)
    assert get(server, path) == path
    assert server.ranges == []


def test_a_file_that_is_whole_needs_neither_the_means_to_download_nor_a_folder_to_write_in(path, monkeypatch):
    path.parent.mkdir()
    path.write_bytes(CONTENT)
    monkeypatch.setitem(sys.modules, "pooch", None)
    monkeypatch.setitem(sys.modules, "filelock", None)
    assert download("http://nowhere.invalid/data.csv", SHA256, len(CONTENT), path) == path
    assert [p.name for p in path.parent.iterdir()] == [path.name]  # no lock beside it


def test_a_spoilt_file_in_the_cache_is_replaced(server, path):
    path.parent.mkdir()
    path.write_bytes(CONTENT[:-1])
    get(server, path)
    assert path.read_bytes() == CONTENT


@pytest.mark.parametrize("mode", ["closes", "closes, untold length"])
def test_a_broken_download_goes_on_where_it_broke(server, path, part, mode):
    server.mode = mode
    with pytest.raises(TraceError, match=rf"broke off .*{CUT} of {len(CONTENT)} bytes are here, run the same command"):
        get(server, path)
    assert left(path) == {part.name}
    assert part.read_bytes() == CONTENT[:CUT]
    server.mode = "good"
    get(server, path)
    assert path.read_bytes() == CONTENT
    assert server.ranges == [None, f"bytes={CUT}-"]
    assert server.sent == [CUT, len(CONTENT) - CUT]
    assert left(path) == {"data.csv"}


@pytest.mark.parametrize("mode", ["no ranges", "shifted"])
def test_a_server_without_ranges_sends_all_again(server, path, part, mode):
    path.parent.mkdir()
    part.write_bytes(CONTENT[:CUT])
    server.mode = mode
    get(server, path)
    assert path.read_bytes() == CONTENT
    assert server.sent[-1] == len(CONTENT)


@pytest.mark.parametrize("extra", [b"", b"more"])
def test_a_part_with_all_bytes_needs_no_more_of_them(server, path, part, extra):
    path.parent.mkdir()
    part.write_bytes(CONTENT + extra)
    get(server, path)
    assert path.read_bytes() == CONTENT
    assert server.ranges == ([f"bytes={len(CONTENT + extra)}-", None] if extra else [])


def test_an_interrupt_leaves_a_part_to_go_on_from(server, path, part):
    def interrupt(have, size):
        if have >= CUT:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        get(server, path, progress=interrupt)
    have = part.stat().st_size
    assert left(path) == {part.name}
    assert CUT <= have < len(CONTENT)
    get(server, path)
    assert path.read_bytes() == CONTENT
    assert server.ranges == [None, f"bytes={have}-"]


@pytest.mark.parametrize(
    "content",
    [CONTENT.replace(b"5,25\n", b"5,99\n", 1), CONTENT[:-7], CONTENT[:-1] + b"\r\n"],
    ids=["changed", "shorter", "longer"],
)
def test_a_tampered_file_is_refused_with_both_checksums(server, path, content):
    server.content = content
    came = hashlib.sha256(content[: len(CONTENT)]).hexdigest()
    for _ in range(2):  # the second try begins afresh
        with pytest.raises(TraceError, match=rf"{SHA256} but got {came}.*Run the same command again"):
            get(server, path)
        assert left(path) == set()
    assert server.ranges == [None, None]
    server.content = CONTENT
    get(server, path)


def test_a_part_of_another_file_is_not_kept(server, path, part):
    path.parent.mkdir()
    part.write_bytes(b"x" * CUT)
    with pytest.raises(TraceError, match="Run the same command again"):
        get(server, path)
    get(server, path)
    assert server.ranges == [f"bytes={CUT}-", None]


def test_a_tampered_file_does_not_take_the_place_of_the_one_there(server, path):
    path.parent.mkdir()
    path.write_bytes(b"by hand")
    server.content = b"tampered"
    wrong = hashlib.sha256(b"by hand").hexdigest()
    with pytest.raises(TraceError, match=rf"the one there now has SHA-256 {wrong}, not {SHA256}"):
        get(server, path)
    assert path.read_bytes() == b"by hand"


@pytest.mark.parametrize("begun", [b"", CONTENT[:CUT]])
def test_a_missing_file_is_named(server, path, part, begun):
    path.parent.mkdir()
    part.write_bytes(begun)
    server.mode = "missing"
    with pytest.raises(TraceError, match=rf"{server.url} answers 404 Not Found; .* put it at {path}"):
        get(server, path)
    assert part.read_bytes() == begun


def test_offline_says_what_to_do(path):
    with socket.create_server(("127.0.0.1", 0)) as free:
        url = f"http://127.0.0.1:{free.getsockname()[1]}/data.csv"
    with pytest.raises(TraceError, match=rf"{url} cannot be reached .*refused.* by hand and put it at {path}"):
        download(url, SHA256, len(CONTENT), path)
    assert left(path) == set()


def test_a_folder_that_cannot_be_made_is_named(server, tmp_path):
    (tmp_path / "cache").write_text("a file")
    with pytest.raises(TraceError, match=r"cache: the file cannot be kept there .*DCGRID_CACHE"):
        get(server, tmp_path / "cache" / "data.csv")


def test_several_at_once_download_once(server, path):
    server.mode = "slow"
    with ThreadPoolExecutor(3) as pool:
        assert list(pool.map(lambda _: get(server, path), range(3))) == [path] * 3
    assert path.read_bytes() == CONTENT
    assert server.sent == [len(CONTENT)]


@pytest.mark.slow
def test_traces_are_imported_without_the_means_to_download():
    code = "import sys, dcgrid_env.traces.recordings; print({'pooch', 'requests', 'filelock'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
