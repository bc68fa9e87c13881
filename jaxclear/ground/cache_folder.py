"""Where machine code is kept between processes: a folder in the user's cache folder, the owner's
alone, bounded in size.

A file is found by a key that says all that its content depends on. Machine code runs as it stands,
so a file is taken only where it, and the folder, belong to this user and nobody else may write
them; what follows its first line must be what the digest there says. All else is a miss: it is
compiled again. Several processes may share the folder: a file appears whole or not at all.
"""

import functools
import hashlib
import os
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

# The folder; "0" or "off": nothing is kept.
VARIABLE = "JAXCLEAR_CACHE"
OFF = ("", "0", "off")
# What tells systems where a user is at home.
OF_USER = ("XDG_CACHE_HOME", "HOME", "LOCALAPPDATA", "USERPROFILE", "HOMEDRIVE", "HOMEPATH")
MARK = b"jaxclear 1 "
# Bytes in all files together, beyond which those go that were used least recently, until so large a
# share is left.
MOST, SHARE_AFTER_CLEANUP = 1 << 29, 0.75
# Kinds: machine code of kernels, and programs around them; characters of a key.
KINDS = KERNEL, PROGRAM = "kernel", "program"
KEY = 40
# How names of files begin that are being written. Of a process that is killed one stays behind; it
# is no process's any more after so long [s].
TEMPORARY_PREFIX, LONGEST = ".new-", 3600.0
JAX = "of_jax"
# What others than the owner may do with a file.
OTHERS = stat.S_IRWXG | stat.S_IRWXO


class CachedFile(NamedTuple):
    """A file with its size [bytes] and when it was last used [s since 1970]."""

    path: Path
    size: int
    used: float


def folder_path() -> Path | None:
    """The folder, whether it exists or not; None where nothing is to be kept."""
    return _folder_on_system(sys.platform, *map(os.environ.get, (VARIABLE, *OF_USER)))


@functools.lru_cache(maxsize=16)
def _folder_on_system(system: str, variable: str | None, *_: str | None) -> Path | None:
    """The folder on a system, from the variable and those that tell where a user is at home."""
    if variable is not None and variable.strip().lower() in OFF:
        return None
    # A system may not know where the user is at home.
    with suppress(RuntimeError):
        base = _of_user() / "jaxclear" if variable is None else Path(variable).expanduser()
        return base / "programs"
    return None


def _of_user() -> Path:
    """The folder of caches of this user, as his system has it."""
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    cache_home = os.environ.get("XDG_CACHE_HOME", "")
    # The standard has paths that are not absolute ignored.
    return Path(cache_home) if os.path.isabs(cache_home) else Path.home() / ".cache"


def read(kind: str, key: str) -> bytes | None:
    """What is kept of a kind under a key; None where nothing is, or nothing that can be trusted."""
    folder = folder_path()
    if folder is None:
        return None
    path = _file_path(folder, kind, key)
    try:
        if not _is_owners(folder.stat()):
            return None
        flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
        with os.fdopen(os.open(path, flags), "rb") as file:
            if not _is_owners(os.fstat(file.fileno())):
                return None
            file_content = file.read()
    except OSError:
        return None
    head, _, content = file_content.partition(b"\n")
    if head != _header_line(path.name, content):
        with suppress(OSError):
            path.unlink()
        return None
    with suppress(OSError):
        os.utime(path)
    return content


def make_folder() -> Path | None:
    """The folder, which is made where it is not there; None where nothing can be kept."""
    folder = folder_path()
    if folder is None:
        return None
    with suppress(OSError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if _is_owners(folder.stat()):
            return folder
    return None


def jax_folder() -> Path | None:
    """A folder within for JAX, which keeps programs, too; None where nothing can be kept."""
    folder = make_folder()
    return None if folder is None else folder / JAX


def write(kind: str, key: str, content: bytes) -> None:
    """Saves a file in the cache folder; where that fails, nothing is saved.

    Args:
        kind: of the content, which is part of the file's name.
        key: under which it is read again.
        content: bytes of the file.
    """
    folder = make_folder()
    if folder is None:
        return
    path = _file_path(folder, kind, key)
    with suppress(OSError):
        # Its file is the owner's alone from the beginning.
        number, name = tempfile.mkstemp(dir=folder, prefix=TEMPORARY_PREFIX)
        try:
            with os.fdopen(number, "wb") as file:
                file.write(_header_line(path.name, content) + b"\n" + content)
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
        _delete_oldest(folder)


def list_files() -> list[CachedFile]:
    """All that is kept, what was used least recently first."""
    folder = folder_path()
    return [] if folder is None else sorted(_files(folder), key=lambda one: one.used)


def clear() -> int:
    """Removes all that is kept, by JAX too; how many files that were."""
    folder, files = folder_path(), [one.path for one in list_files()]
    if folder is not None:
        files += _list_stale_files(folder, after=0.0)
    if folder is not None and (folder / JAX).is_dir():
        files += [path for path in (folder / JAX).iterdir() if path.is_file()]
    for path in files:
        path.unlink(missing_ok=True)
    return len(files)


def _file_path(folder: Path, kind: str, key: str) -> Path:
    return folder / f"{key}.{kind}"


def _header_line(name: str, content: bytes) -> bytes:
    """The first line of a file of this name."""
    return MARK + hashlib.sha256(name.encode() + b"\n" + content).hexdigest().encode()


def _is_owners(status: os.stat_result) -> bool:
    """Whether a file or folder belongs to this user, and others have no part in it."""
    user = getattr(os, "geteuid", None)
    # Windows, which knows no such numbers, keeps a user's own folders from others.
    return user is None or (status.st_uid == user() and not status.st_mode & OTHERS)


def _files(folder: Path) -> Iterator[CachedFile]:
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            with suppress(OSError):
                if entry.is_file(follow_symlinks=False) and _is_cached(entry.name):
                    status = entry.stat(follow_symlinks=False)
                    yield CachedFile(Path(entry.path), status.st_size, status.st_mtime)


def _is_cached(name: str) -> bool:
    """Whether a file of this name is one of those that are kept; other files stay as they are."""
    key, _, kind = name.partition(".")
    return len(key) == KEY and kind in KINDS


def key_of(*parts: str) -> str:
    """A key that depends on all of these texts."""
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:KEY]


def _list_stale_files(folder: Path, after: float) -> list[Path]:
    """Files that have been under way for so long [s]."""
    stale = []
    with suppress(OSError):
        for path in folder.glob(f"{TEMPORARY_PREFIX}*"):
            with suppress(OSError):
                if path.lstat().st_mtime <= time.time() - after:
                    stale.append(path)
    return stale


def _delete_oldest(folder: Path) -> None:
    for path in _list_stale_files(folder, LONGEST):
        with suppress(OSError):
            path.unlink()
    files = sorted(_files(folder), key=lambda one: one.used)
    total = sum(one.size for one in files)
    if total <= MOST:
        return
    for one in files:
        with suppress(OSError):
            one.path.unlink()
        total -= one.size
        if total <= SHARE_AFTER_CLEANUP * MOST:
            return
