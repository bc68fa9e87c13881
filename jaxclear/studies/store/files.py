"""Files of a study's folder: the numbers of one answer each, named by a digest of what was asked.

A file is a NumPy archive (.npz): arrays and text, each with a checksum, and the name that it was
given; nothing in it is run when it is read. It is written beside and renamed, so it is whole or not
there; two processes that computed the same wrote the same bytes.
"""

import errno
import hashlib
import importlib.util
import io
import json
import secrets
import shutil
import time
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np

from jaxclear.ground.wording import described

# Within a study's folder: its files, those on their way, and who is at which.
PIECES, UNFINISHED, CLAIMS = "pieces", ".unfinished", ".claims"
ABOUT = "about.json"
# Within that, by which name a file was written: a renamed one answers another question.
NAMED = "address"
# Of a digest, in hexadecimal.
DIGITS = 32
# Age [s] of what a process that died left behind.
ABANDONED = 3600.0
# What helps where nothing can be written; else the reason has to go.
FULL = (errno.ENOSPC, errno.EDQUOT)


# What is said of a file.
MENDED = "{} does not match its checksum; what it held is computed again."


class Unwritable(OSError):
    """Nothing can be written into a folder: its disk is full, or it is read-only."""


class Piece(NamedTuple):
    """What a file tells of its numbers, and these by name."""

    about: dict[str, Any]
    arrays: dict[str, np.ndarray]


def address_of(*parts: Any) -> str:
    """A digest of texts, numbers and arrays."""
    found = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            said = f"{part.dtype.str} {part.shape}"
            found.update(f"{said} ".encode() + np.ascontiguousarray(part).tobytes())
        else:
            found.update(json.dumps(part, sort_keys=True).encode())
        found.update(b"\n")
    return found.hexdigest()[:DIGITS]


class Pieces:
    """The files of a folder. `damaged`: those that were met and do not match their checksums."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.damaged: set[str] = set()

    def path(self, address: str) -> Path:
        """Of the file with this address."""
        return self.folder / PIECES / f"{address}.npz"

    def read(self, address: str, names: Sequence[str] | None = None) -> Piece | None:
        """A piece, with all its numbers or those of these names; None where it is not there,
        damaged, or that of another address."""
        try:
            with zipfile.ZipFile(self.path(address)) as archive:
                there = [own[: -len(".npy")] for own in archive.namelist() if own != ABOUT]
                wanted = there if names is None else [own for own in names if own in there]
                about = json.loads(archive.read(ABOUT))
                if about.pop(NAMED) != address:
                    raise ValueError("another piece")
                return Piece(about, {own: _array(archive.read(f"{own}.npy")) for own in wanted})
        except FileNotFoundError:
            return None
        except PermissionError:
            raise
        # Whatever a damaged file makes of zip, of deflate and of NumPy.
        except Exception:
            self.damaged.add(address)
            return None

    def write(
        self,
        address: str,
        about: Mapping[str, Any],
        arrays: Mapping[str, Any],
        squeezed: Sequence[str] = (),
    ) -> None:
        """Keeps a piece. `squeezed`: names of arrays that repeat themselves and are compressed;
        digits of others are noise to a compressor. Raises `Unwritable`."""
        whole = io.BytesIO()
        with zipfile.ZipFile(whole, "w") as archive:
            told = json.dumps({**about, NAMED: address}, sort_keys=True)
            archive.writestr(zipfile.ZipInfo(ABOUT), told)
            for name, numbers in arrays.items():
                how = zipfile.ZIP_DEFLATED if name in squeezed else zipfile.ZIP_STORED
                raw = io.BytesIO()
                np.lib.format.write_array(raw, np.asarray(numbers), allow_pickle=False)
                archive.writestr(zipfile.ZipInfo(f"{name}.npy"), raw.getbuffer(), how, 1)
        put(self.path(address), whole.getvalue(), self.folder)
        self.damaged.discard(address)

    @contextmanager
    def claimed(self, address: str) -> Iterator[bool]:
        """Whether this thread may compute a piece, or another one, of this process or of another,
        is at it. The system takes claims back from processes that end."""
        import filelock

        lock = filelock.FileLock(self.folder / CLAIMS / address, timeout=0, thread_local=False)
        try:
            (self.folder / CLAIMS).mkdir(exist_ok=True)
            lock.acquire()
        except (filelock.Timeout, FileNotFoundError, FileExistsError):
            # Somebody is at it, or has finished the campaign and tidies up: pathlib may find the
            # folder there, and a moment later not.
            yield False
            return
        except OSError as reason:
            refuse_unwritable(self.folder, reason)
        try:
            yield True
        finally:
            lock.release()

    def tidy(self) -> None:
        """Takes away claims, and what those left that died long ago."""
        shutil.rmtree(self.folder / CLAIMS, ignore_errors=True)
        for left in (self.folder / UNFINISHED).glob("*"):
            with suppress(OSError):
                if time.time() - left.stat().st_mtime > ABANDONED:
                    left.unlink()


def _array(content: bytes) -> np.ndarray:
    return np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)


def put(path: Path, content: bytes, folder: Path) -> None:
    """Writes a file of a study's folder beside, and renames it. Raises `Unwritable`."""
    beside = folder / UNFINISHED / secrets.token_hex(16)
    try:
        beside.parent.mkdir(parents=True, exist_ok=True)
        path.parent.mkdir(parents=True, exist_ok=True)
        beside.write_bytes(content)
        beside.replace(path)
    except BaseException as reason:
        with suppress(OSError):
            beside.unlink(missing_ok=True)
        if isinstance(reason, OSError):
            refuse_unwritable(folder, reason)
        raise


def refuse_unwritable(folder: Path, reason: OSError) -> NoReturn:
    """Raises `Unwritable` with a sentence."""
    cure = "make room" if reason.errno in FULL else "let it be written"
    raise Unwritable(
        f"nothing can be written into the folder {folder} ({reason.strerror or reason}). What was "
        f"finished is kept there; {cure}, ask the same again, and it goes on from there."
    ) from reason


def checked_folder(folder: Any) -> Path:
    """The path of a folder in which a study is kept, or can be. Raises `ValueError` with a
    sentence, `ImportError` without what keeps it."""
    if importlib.util.find_spec("zarr") is None or importlib.util.find_spec("filelock") is None:
        raise ImportError('a store needs zarr: python -m pip install "jaxclear[store]".')
    if not isinstance(folder, (str, Path)) or not str(folder):
        raise ValueError(f"store is {described(folder)}; it must be the path of a folder.")
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"the store {folder} is a file; give a folder.")
    return folder
