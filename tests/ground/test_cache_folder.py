"""What is kept between processes is the owner's alone, whole or not there, and bounded."""

import os
import threading

import pytest

from jaxclear.ground import cache_folder
from jaxclear.ground.cache_folder import (
    KERNEL,
    PROGRAM,
    folder_path,
    key_of,
    list_files,
    read,
    write,
)

KEY = key_of("a", "program")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(cache_folder.VARIABLE, str(tmp_path))
    return tmp_path / "programs"


@pytest.fixture
def file(folder):
    """One that is kept."""
    write(KERNEL, KEY, b"one")
    return list_files()[0].path


def test_what_is_kept_is_found_by_its_kind_and_key(folder):
    assert read(KERNEL, KEY) is None
    write(KERNEL, KEY, b"one")
    write(PROGRAM, KEY, b"two")
    write(PROGRAM, KEY, b"three")
    assert (read(KERNEL, KEY), read(PROGRAM, KEY)) == (b"one", b"three")
    assert read(KERNEL, key_of("another")) is None
    assert len(list_files()) == 2 and cache_folder.clear() == 2 and list_files() == []


@pytest.mark.skipif(os.name == "nt", reason="permissions of POSIX")
@pytest.mark.parametrize("others", [0o040, 0o020, 0o004, 0o002])
def test_what_others_may_touch_is_not_taken(folder, file, others):
    assert folder.stat().st_mode & 0o777 == 0o700 and file.stat().st_mode & 0o777 == 0o600
    file.chmod(0o600 | others)
    assert read(KERNEL, KEY) is None
    file.chmod(0o600)
    assert read(KERNEL, KEY) == b"one"
    folder.chmod(0o700 | others)
    assert read(KERNEL, KEY) is None
    write(PROGRAM, KEY, b"two")
    folder.chmod(0o700)
    assert read(PROGRAM, KEY) is None


def test_a_link_and_what_belongs_to_another_user_are_not_taken(file, monkeypatch, tmp_path):
    other = tmp_path / "elsewhere"
    file.rename(other)
    file.symlink_to(other)
    assert read(KERNEL, KEY) is None
    file.unlink()
    other.rename(file)
    assert read(KERNEL, KEY) == b"one"
    user = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: user + 1)
    assert read(KERNEL, KEY) is None


DAMAGES = {
    "cut": lambda whole: whole[:-1],
    "a bit": lambda whole: whole[:-1] + b"X",
    "empty": lambda whole: b"",
    "its mark": lambda whole: b"X" + whole[1:],
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_file_is_a_miss_and_goes(file, name):
    file.write_bytes(DAMAGES[name](file.read_bytes()))
    assert read(KERNEL, KEY) is None and list_files() == []


def test_a_file_under_the_name_of_another_is_a_miss(folder, file):
    other = key_of("another")
    file.rename(folder / f"{other}.{KERNEL}")
    assert read(KERNEL, other) is None


def test_what_was_used_least_recently_goes_first(folder, monkeypatch):
    monkeypatch.setattr(cache_folder, "MOST", 1200)
    keys = [key_of(str(i)) for i in range(3)]
    for i, key in enumerate(keys):
        write(KERNEL, key, bytes(300))
        os.utime(folder / f"{key}.{KERNEL}", (i, i))
    (folder / "of another program").write_bytes(bytes(5000))
    # Being read is being used.
    read(KERNEL, keys[0])
    write(KERNEL, key_of("last"), bytes(300))
    assert [read(KERNEL, key) is not None for key in keys] == [True, False, False]
    assert read(KERNEL, key_of("last")) is not None
    assert (folder / "of another program").exists()


def test_several_at_once_find_it_whole_or_not_at_all(folder):
    contents = [bytes([i]) * 200_000 for i in range(4)]
    found = []

    def work(own):
        for _ in range(30):
            write(KERNEL, KEY, own)
            found.append(read(KERNEL, KEY))

    threads = [threading.Thread(target=work, args=(own,)) for own in contents]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert set(found) <= {*contents}
    assert len(list(folder.iterdir())) == 1


def test_what_a_killed_process_was_writing_goes(folder, file):
    old, new = (folder / f"{cache_folder.TEMPORARY_PREFIX}{name}" for name in ("old", "new"))
    for path in (old, new):
        path.write_bytes(bytes(100))
    os.utime(old, (0, 0))
    write(PROGRAM, KEY, b"two")
    assert new.exists() and not old.exists() and len(list_files()) == 2
    assert cache_folder.clear() == 3 and list(folder.iterdir()) == []


@pytest.mark.parametrize("off", ["", "0", "off", "OFF"])
def test_it_can_be_switched_off(off, monkeypatch):
    monkeypatch.setenv(cache_folder.VARIABLE, off)
    write(KERNEL, KEY, b"one")
    assert folder_path() is None and read(KERNEL, KEY) is None and list_files() == []
    assert cache_folder.jax_folder() is None


@pytest.mark.skipif(os.name == "nt", reason="the folders of other systems")
def test_it_lies_in_the_users_cache_folder(tmp_path, monkeypatch):
    monkeypatch.delenv(cache_folder.VARIABLE)
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert folder_path() == tmp_path / "jaxclear" / "programs"
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for given in ("", "relative"):
        monkeypatch.setenv("XDG_CACHE_HOME", given)
        assert folder_path() == tmp_path / "home" / ".cache" / "jaxclear" / "programs"
    monkeypatch.setattr("sys.platform", "darwin")
    assert folder_path() == tmp_path / "home" / "Library" / "Caches" / "jaxclear" / "programs"


def test_a_full_disk_costs_no_run(folder, monkeypatch):
    def full(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr(os, "replace", full)
    write(KERNEL, KEY, b"one")
    assert list(folder.iterdir()) == []
