"""The watch over readers: what it forbids fails, and what it allows does not."""

import os
import pathlib
import re
import shutil
import socket
import subprocess
import sys
import time

import pytest
import watch
from watch import watched


@pytest.fixture
def folders(tmp_path):
    """The folder that may be touched, `a`, and things outside whose names begin as its name does."""
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "file").write_text("inside")
    (tmp_path / "a.txt").write_text("outside")
    (tmp_path / "ab").mkdir()
    (tmp_path / "a" / "link").symlink_to("../a.txt")
    shutil.make_archive(str(tmp_path / "a"), "tar", tmp_path / "ab")
    return tmp_path


def connect(_):
    with socket.socket() as one:
        one.connect_ex(("127.0.0.1", 9))


def send(_):
    with socket.socket(type=socket.SOCK_DGRAM) as one:
        one.sendto(b"", ("127.0.0.1", 9))


FORBIDDEN = {
    "open": lambda at: (at / "a.txt").read_text(),
    "open through a link": lambda at: (at / "a" / "link").read_text(),
    "open to write": lambda at: (at / "ab" / "new").write_text(""),
    "open, cut": lambda at: os.close(os.open(at / "a.txt", os.O_RDONLY | os.O_TRUNC)),
    "os.remove": lambda at: os.remove(at / "a.txt"),
    "os.rename": lambda at: os.rename(at / "a" / "file", at / "ab" / "file"),
    "os.mkdir": lambda at: os.mkdir(at / "abc"),
    "os.rmdir": lambda at: os.rmdir(at / "ab"),
    "os.symlink": lambda at: os.symlink(at / "a" / "file", at / "new"),
    "os.link": lambda at: os.link(at / "a.txt", at / "a" / "new"),
    "os.truncate": lambda at: os.truncate(at / "a.txt", 0),
    "os.chmod": lambda at: os.chmod(at / "a.txt", 0o600),
    "os.utime": lambda at: os.utime(at / "a.txt"),
    "os.chown": lambda at: os.chown(at / "a.txt", -1, -1),
    "shutil.copyfile": lambda at: shutil.copyfile(at / "a" / "file", at / "new"),
    "shutil.copymode": lambda at: shutil.copymode(at / "a" / "file", at / "a.txt"),
    "shutil.copystat": lambda at: shutil.copystat(at / "a" / "file", at / "a.txt"),
    "shutil.copytree": lambda at: shutil.copytree(at / "ab", at / "a" / "new"),
    "shutil.move": lambda at: shutil.move(at / "a" / "file", at / "new"),
    "shutil.rmtree": lambda at: shutil.rmtree(at / "ab"),
    "shutil.make_archive": lambda at: shutil.make_archive(str(at / "new"), "tar", at / "a"),
    "shutil.unpack_archive": lambda at: shutil.unpack_archive(at / "a.tar", at / "a"),
    "socket.connect": connect,
    "socket.sendto": send,
}


@pytest.mark.parametrize("name", FORBIDDEN)
def test_nothing_outside_is_touched(folders, name):
    with pytest.raises(AssertionError, match=name.split()[0].rstrip(",")), watched(folders / "a"):
        FORBIDDEN[name](folders)


def test_what_others_own_may_be_read_but_not_written(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    monkeypatch.setattr(watch, "_ALLOWED", [str(tmp_path / "own"), *watch._ALLOWED])
    (tmp_path / "own").write_text("")
    (tmp_path / "owner").write_text("")
    with watched(tmp_path / "a"):
        (tmp_path / "own").read_text()
        pathlib.Path(os.__file__).read_bytes()
    for touch in ((tmp_path / "own").touch, (tmp_path / "owner").read_text):
        with pytest.raises(AssertionError, match=r"(open|os.utime) .*/own"), watched(tmp_path / "a"):
            touch()


def test_the_folder_itself_may_be_used(folders):
    with watched(folders / "a"):
        (folders / "a" / "new").write_text("new")
        os.rename(folders / "a" / "new", folders / "a" / "newer")
        os.chmod(folders / "a" / "newer", 0o600)
        os.truncate(folders / "a" / "newer", 1)
        shutil.copyfile(folders / "a" / "newer", folders / "a" / "copy")
        os.remove(folders / "a" / "newer")
        pathlib.Path(os.devnull).write_text("")
    (folders / "a.txt").read_text()


FILL = """
import numpy as np
from watch import watched

def told(megabytes):
    try:
        with watched("."):
            np.full(megabytes << 17, 1.0)
        return "nothing"
    except AssertionError as error:
        return error

np.full(900 << 17, 1.0)
print(told(800), told(800), told(400), sep="\\n")
"""


def test_each_allocation_counts_anew(tmp_path):
    """Also one that a larger one before would hide: seen in a process that frees nothing else at the same time."""
    if not os.access("/proc/self/clear_refs", os.W_OK):
        pytest.skip("this system does not let a process forget its peak of memory")
    path = {"PYTHONPATH": os.pathsep.join([str(pathlib.Path(__file__).parent), *sys.path])}
    run = subprocess.run(
        [sys.executable, "-c", FILL], env=os.environ | path, capture_output=True, text=True, check=True
    )
    assert re.fullmatch(r"took [78]\d\d MB\ntook [78]\d\d MB\nnothing\n", run.stdout)


def test_without_proc_the_first_allocation_counts(tmp_path, monkeypatch):
    """A peak of this process so far stands for that of a new one."""
    peaks = iter((100, 100 + 513 * 1024))
    monkeypatch.setattr(watch.pathlib, "Path", lambda _: (_ for _ in ()).throw(FileNotFoundError()))
    monkeypatch.setattr(watch.resource, "getrusage", lambda _: type("Usage", (), {"ru_maxrss": next(peaks)}))
    with pytest.raises(AssertionError, match=r"^took 513 MB"), watched(str(tmp_path)):
        pass


def test_computing_too_long_fails(tmp_path, monkeypatch):
    monkeypatch.setattr(watch, "SECONDS", 0.05 / watch.SLACK)
    with pytest.raises(AssertionError, match=r"^computed for 0\.[1-9] s"), watched(tmp_path):
        end = time.process_time() + 0.11
        while time.process_time() < end:
            pass


def test_waiting_too_long_fails(tmp_path, monkeypatch):
    monkeypatch.setattr(watch, "SECONDS", 0.01)
    with pytest.raises(AssertionError, match=r"^took 0\.[1-9] s"), watched(tmp_path):
        time.sleep(0.2)


def test_what_is_raised_inside_comes_out_and_ends_the_watch(folders):
    with pytest.raises(KeyError), watched(folders / "a"):
        raise KeyError
    (folders / "a.txt").read_text()
    assert watch._watching == []
    assert sys.exc_info() == (None, None, None)
