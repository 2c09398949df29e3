import errno
import os
import re
import signal
import threading

import pytest
from matplotlib.figure import Figure

from dcgrid_env.core.files import (
    clear_parts,
    new_folder,
    require_folder,
    require_space,
    whole,
    whole_folder,
    write_bytes,
    write_figure,
    write_json,
    write_text,
)


def test_what_is_written_is_there_with_the_rights_of_any_other_file(tmp_path):
    path = tmp_path / "a" / "b" / "note.md"
    write_text(path, "first\n")
    write_text(path, "±\n")
    assert path.read_bytes() == "±\n".encode()
    (tmp_path / "plain").touch()
    assert path.stat().st_mode == (tmp_path / "plain").stat().st_mode
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, OSError])
def test_what_fails_leaves_the_file_as_it_was_and_nothing_beside_it(tmp_path, error):
    def half(file):
        file.write(b"half")
        raise error

    (tmp_path / "old").write_text("old")
    for path in (tmp_path / "old", tmp_path / "new" / "deep" / "file"):
        with pytest.raises(error), whole(path) as file:
            half(file)
    assert [path.name for path in tmp_path.iterdir()] == ["old"]
    assert (tmp_path / "old").read_text() == "old"


def test_a_folder_is_filled_whole_or_not_at_all(tmp_path):
    out = tmp_path / "a" / "out"

    def half(folder):
        (folder / "one").write_text("1")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), whole_folder(out) as folder:
        half(folder)
    assert list(tmp_path.iterdir()) == []
    for text in ("new", "empty"):
        with whole_folder(out) as folder:
            (folder / "one").write_text(text)
        assert ((out / "one").read_text(), len(list(out.parent.iterdir()))) == (text, 1)
        (out / "one").unlink()
    (out / "kept").touch()
    with pytest.raises(FileExistsError, match="filled meanwhile"), whole_folder(out) as folder:
        (folder / "one").touch()
    assert [path.name for path in out.iterdir()] == ["kept"]
    assert len(list(out.parent.iterdir())) == 1


def test_files_that_differ_in_their_suffix_do_not_meet(tmp_path):
    """results.json and results.md once shared the name under which they were written."""
    with whole(tmp_path / "results.json") as one, whole(tmp_path / "results.md") as other:
        one.write(b"json")
        other.write(b"md")
    assert ((tmp_path / "results.json").read_bytes(), (tmp_path / "results.md").read_bytes()) == (b"json", b"md")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes")
def test_pipes_devices_and_links_to_them_are_not_replaced(tmp_path):
    pipe, link = tmp_path / "pipe", tmp_path / "link"
    os.mkfifo(pipe)
    link.symlink_to(os.devnull)
    for path in (pipe, link):
        with pytest.raises(FileExistsError, match=f"{path} is a device or a pipe; give the path of a file"):
            write_bytes(path, b"1")
    assert pipe.is_fifo()
    assert link.is_symlink()
    assert sorted(tmp_path.iterdir()) == [link, pipe]


def test_two_who_write_the_same_file_at_once_leave_the_whole_of_one(tmp_path):
    path, failed = tmp_path / "file", []

    def write(sign):
        try:
            for _ in range(40):
                write_text(path, sign * 50_000)
        except OSError as error:
            failed.append(error)

    threads = [threading.Thread(target=write, args=(sign,)) for sign in "ab"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed
    assert set(path.read_text()) in ({"a"}, {"b"})
    assert len(path.read_text()) == 50_000
    assert list(tmp_path.iterdir()) == [path]


def test_ctrl_c_before_a_file_is_in_place_leaves_nothing(tmp_path, monkeypatch):
    def interrupted(fd):
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_text(tmp_path / "folder" / "file", "text")
    assert not list(tmp_path.iterdir())


def test_json_with_a_nan_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(ValueError, match="Out of range float"):
        write_json(tmp_path / "folder" / "x.json", {"J": float("nan")})
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_figure_has_the_format_of_its_suffix(tmp_path):
    for name, begins in (("a.png", b"\x89PNG"), ("b.pdf", b"%PDF"), ("c", b"\x89PNG")):
        write_figure(tmp_path / name, Figure(), dpi=10)
        assert (tmp_path / name).read_bytes().startswith(begins)
    with pytest.raises(ValueError, match=re.escape("'xyz'")):
        write_figure(tmp_path / "folder" / "d.xyz", Figure(), dpi=10)
    assert not (tmp_path / "folder").exists()


def test_folders_made_for_nothing_go_again_and_no_others(tmp_path):
    def fill_and_fail(folder):
        (folder.parent / "kept").touch()
        raise ZeroDivisionError

    (tmp_path / "there").mkdir()
    with pytest.raises(ZeroDivisionError), new_folder(tmp_path / "there" / "a" / "b"):
        raise ZeroDivisionError
    assert not list((tmp_path / "there").iterdir())
    with pytest.raises(ZeroDivisionError), new_folder(tmp_path / "there" / "a" / "b") as folder:
        fill_and_fail(folder)
    assert [path.name for path in (tmp_path / "there").rglob("*")] == ["a", "kept"]
    require_folder(tmp_path / "there" / "c" / "d")
    assert not (tmp_path / "there" / "c").exists()
    with pytest.raises(OSError, match="kept"):
        require_folder(tmp_path / "there" / "a" / "kept" / "deep")


def test_parts_of_a_killed_process_can_be_cleared(tmp_path):
    writing = whole(tmp_path / "checkpoint.pt")
    writing.__enter__()
    (tmp_path / "mine.part").touch()
    assert len(list(tmp_path.iterdir())) == 2
    clear_parts(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.part"]


def test_a_full_disk_is_said_of_the_file(tmp_path):
    path = tmp_path / "note.md"
    with pytest.raises(OSError, match=r"No space left on device: '.*note\.md'"), whole(path):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert list(tmp_path.iterdir()) == []
    require_space(tmp_path, 2**16)
    with pytest.raises(OSError, match=r"No space left|too large"):
        require_space(tmp_path, 2**62)
    assert list(tmp_path.iterdir()) == []
