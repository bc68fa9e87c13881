"""What a study has computed, in plain files of a folder: one for each chunk, found by its address,
a digest of what was asked.

A chunk is SHA-256 over its address and all that follows: a line of JSON (what it says of itself;
names, types and shapes of its arrays), then the arrays. It is written under another name and
renamed, so it is whole or absent, and two processes that computed the same write the same bytes.
Nothing in it is executed when it is read. What study it is stands in `study.json`.
"""

import errno
import functools
import hashlib
import inspect
import json
import secrets
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, ParamSpec, TypeVar

import numpy as np

from jaxclear.ground.arguments import expect
from jaxclear.ground.warning import warn
from jaxclear.ground.wording import described
from jaxclear.studies.problem import Problem
from jaxclear.studies.store.digest import first_difference, in_texts

P, R = ParamSpec("P"), TypeVar("R")
# Within a folder: its study, its chunks, files on their way, and who computes which chunk.
STUDY, CHUNKS, UNFINISHED, CLAIMS = "study.json", "chunks", ".unfinished", ".claims"
CHECKSUM, FORMAT = "checksum", "format"
# Of these files.
THIS_FORMAT = 1
# Bytes of a checksum; where arrays begin.
HASH_SIZE, ALIGNMENT = 32, 8
# Of an address, in hexadecimal.
DIGITS = 32
# Age [s] of files that a process which died did not finish.
ABANDONED = 3600.0
# What helps where nothing can be written; else the reason has to go.
FULL = (errno.ENOSPC, errno.EDQUOT)


class StoreError(OSError):
    """Nothing can be written into a folder: its disk is full, or it is read-only."""


class OtherStudyError(ValueError):
    """A folder holds another study than the one that is to go on there."""


class DamagedStudyError(ValueError):
    """What a folder says of its study does not match its checksum."""


class Chunk(NamedTuple):
    """What a file says of its numbers, and these by name."""

    about: dict[str, Any]
    arrays: dict[str, np.ndarray]


def compute_address(*parts: Any) -> str:
    """A digest of texts, numbers and arrays."""
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            digest.update(f"{part.dtype.str} {part.shape} ".encode())
            digest.update(np.ascontiguousarray(part).tobytes())
        else:
            digest.update(json.dumps(part, sort_keys=True).encode())
        digest.update(b"\n")
    return digest.hexdigest()[:DIGITS]


class Store:
    """The chunks of a study in a folder. `damaged`: addresses of files that were read and do not
    match their checksum; `loaded`: samples that were read and not computed."""

    def __init__(self, folder: Path, description: dict[str, Any] | None = None):
        self.folder, self.description = folder, description
        self.damaged: set[str] = set()
        self._made: set[Path] = set()
        self.loaded = 0

    @classmethod
    def open(cls, folder: Any, what: str, texts: dict[str, str]) -> "Store":
        """The store of a study in a folder.

        Args:
            folder: path.
            what: kind of study.
            texts: the problem in texts, by which a folder is recognised.

        Raises:
            ValueError: the folder holds something else.
        """
        store = cls(check_folder(folder), {"what": what, "problem": json.dumps(texts)})
        saved = store.describe(mend=True)
        if saved is None:
            store.refuse_foreign("study")
        else:
            store.refuse_other(saved, what, texts)
        return store

    def path(self, address: str) -> Path:
        """Of the chunk with this address."""
        return self.folder / f"{CHUNKS}/{address}.chunk"

    def read(self, address: str) -> Chunk | None:
        """A chunk; None where it is absent, damaged, or that of another address."""
        try:
            content = self.path(address).read_bytes()
        except FileNotFoundError:
            return None
        if _checksum(address, memoryview(content)[HASH_SIZE:]) != content[:HASH_SIZE]:
            self.damaged.add(address)
            return None
        end = content.index(b"\n", HASH_SIZE) + 1
        about, kinds = json.loads(content[HASH_SIZE:end])
        arrays = {}
        for name, kind, shape in kinds:
            count = int(np.prod(shape))
            arrays[name] = np.frombuffer(content, kind, count, end).reshape(shape)
            end += arrays[name].nbytes + -arrays[name].nbytes % ALIGNMENT
        return Chunk(about, arrays)

    def load(self, address: str) -> Chunk | None:
        """As `read`, with a warning where the file is damaged."""
        chunk = self.read(address)
        if address in self.damaged:
            path = self.path(address)
            warn(f"{path} does not match its checksum; what it held is computed again.")
            self.damaged.discard(address)
        return chunk

    def write(
        self, address: str, arrays: Mapping[str, Any], about: Mapping[str, Any] | None = None
    ) -> None:
        """Saves a chunk.

        Args:
            address: digest by which it is found.
            arrays: its numbers by name.
            about: what else the file says of them, as JSON.

        Raises:
            StoreError: the file cannot be written.
        """
        if self.description is not None:
            self.record(self.description)
            self.description = None
        numbers = {name: np.asarray(array, order="C") for name, array in arrays.items()}
        kinds = [(name, array.dtype.str, array.shape) for name, array in numbers.items()]
        head = json.dumps([about, kinds]).encode()
        parts: list[Any] = [head, b" " * (-(len(head) + 1) % ALIGNMENT), b"\n"]
        for array in numbers.values():
            parts += [array, bytes(-array.nbytes % ALIGNMENT)]
        self._put(self.path(address), b"".join([_checksum(address, *parts), *parts]))
        self.damaged.discard(address)

    @contextmanager
    def claim(self, address: str, wait: bool = False) -> Iterator[bool]:
        """Whether this thread may compute a chunk, or another one, of this process or of another,
        is at it; `wait`: until it may. The system takes claims back from processes that end."""
        import filelock

        path, timeout = self.folder / CLAIMS / address, -1 if wait else 0
        lock = filelock.FileLock(path, timeout, thread_local=False)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            lock.acquire()
        except (filelock.Timeout, FileNotFoundError, FileExistsError):
            # Somebody is at it, or has finished the study and removes claims: pathlib may find the
            # folder there, and a moment later not.
            yield False
            return
        except OSError as reason:
            self._refuse_unwritable(reason)
        try:
            yield True
        finally:
            lock.release()

    def obtain(
        self, address: str, load: Callable[[], Any], compute: Callable[[], Any], wait: bool = False
    ) -> Any:
        """A chunk, loaded or computed; None where another process or thread is at it.

        Args:
            address: digest by which it is found.
            load: function that reads it; None: it is not there.
            compute: function that computes and saves it.
            wait: whether to wait for the other process.
        """
        result = load()
        if result is None:
            with self.claim(address, wait) as claimed:
                result = load()
                if result is None and (claimed or wait):
                    result = compute()
        return result

    def tidy(self) -> None:
        """Removes claims, and files that processes which died long ago did not finish."""
        shutil.rmtree(self.folder / CLAIMS, ignore_errors=True)
        for path in (self.folder / UNFINISHED).glob("*"):
            with suppress(OSError):
                if time.time() - path.stat().st_mtime > ABANDONED:
                    path.unlink()

    def describe(self, mend: bool = False) -> dict[str, Any] | None:
        """What the folder says of its study; None where there is none. Where that is damaged, None
        too if it is to be mended, with a warning; else raises `DamagedStudyError`."""
        path = self.folder / STUDY
        if not path.exists():
            return None
        saved: Any = {}
        with suppress(ValueError, KeyError, AttributeError, TypeError):
            saved = json.loads(path.read_text())
            if saved.pop(CHECKSUM) != compute_address(saved):
                saved = {}
        if saved:
            return saved if saved.get(FORMAT) == THIS_FORMAT else self._refuse_earlier()
        if mend:
            warn(f"{path} does not match its checksum; it is written again from what is asked.")
            return None
        raise DamagedStudyError(
            f"{path} does not match its checksum; ask the same study of the same problem again, "
            "which writes it anew and computes nothing that is kept."
        )

    def record(self, description: dict[str, Any]) -> None:
        """Writes what the folder says of its study, where it says something else."""
        # Numbers and texts as they are read again.
        saved = json.loads(json.dumps({FORMAT: THIS_FORMAT} | description))
        text = json.dumps(saved | {CHECKSUM: compute_address(saved)}, indent=1)
        path = self.folder / STUDY
        if not path.exists() or path.read_text() != text:
            self._put(path, text.encode())

    def update(self, change: Callable[[dict[str, Any] | None], dict[str, Any]]) -> dict[str, Any]:
        """Changes what the folder says of its study, one process at a time: what it says then."""
        with self.claim(STUDY, wait=True):
            saved = None
            with suppress(DamagedStudyError):
                saved = self.describe()
            saved = change(saved)
            self.record(saved)
        return saved

    def refuse_foreign(self, what: str) -> None:
        """Raises `ValueError` with a sentence for a folder with something else than files of a
        study."""
        names = {path.name for path in self.folder.iterdir()} if self.folder.exists() else set()
        if not names & {CHUNKS, STUDY} and any(not name.startswith(".") for name in names):
            raise ValueError(
                f"the folder {self.folder} is not empty and holds no {what}; give another one."
            )

    def refuse_other(self, saved: dict[str, Any], what: str, texts: dict[str, str]) -> None:
        """Raises `OtherStudyError` where a folder holds another kind of study or problem.

        Args:
            saved: what the folder says of itself.
            what: required kind of study.
            texts: required problem.
        """
        if saved["what"] != what:
            raise OtherStudyError(
                f"the folder {self.folder} holds {saved['what']}, not {what}; give another one."
            )
        difference = first_difference(json.loads(saved["problem"]), texts)
        if difference:
            raise OtherStudyError(
                f"the folder {self.folder} holds {what} of another problem: {difference}. Give "
                "another folder, or delete this one."
            )

    def _put(self, path: Path, content: bytes) -> None:
        temporary = self.folder / f"{UNFINISHED}/{secrets.token_hex(16)}"
        try:
            # Asked once: a chunk of quick samples takes little longer.
            for parent in {temporary.parent, path.parent} - self._made:
                parent.mkdir(parents=True, exist_ok=True)
                self._made.add(parent)
            temporary.write_bytes(content)
            temporary.replace(path)
        except BaseException as reason:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            if isinstance(reason, OSError):
                self._refuse_unwritable(reason)
            raise

    def _refuse_unwritable(self, reason: OSError) -> NoReturn:
        cure = "make room" if reason.errno in FULL else "let it be written"
        raise StoreError(
            f"nothing can be written into the folder {self.folder} ({reason.strerror or reason}). "
            f"What was finished is kept there; {cure}, ask the same again, and it goes on from "
            "there."
        ) from reason

    def _refuse_earlier(self) -> NoReturn:
        raise OtherStudyError(
            f"the folder {self.folder} was written by another version of jaxclear, whose files "
            "this one does not read; give another folder, or delete this one."
        )


def _checksum(address: str, *parts: Any) -> bytes:
    digest = hashlib.sha256(address.encode())
    for part in parts:
        digest.update(part)
    return digest.digest()


def check_folder(folder: Any) -> Path:
    """The path of a folder in which a study is kept, or can be. Raises `ValueError` with a
    sentence."""
    if not isinstance(folder, (str, Path)) or not str(folder):
        raise ValueError(f"store is {described(folder)}; it must be the path of a folder.")
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"the store {folder} is a file; give a folder.")
    return folder


CURRENT: ContextVar[Store | None] = ContextVar("store of the current study", default=None)


@contextmanager
def open_store(folder: Any, what: str, problem: Problem) -> Iterator[None]:
    """A context in which what a study computes is saved in a folder.

    Args:
        folder: path; None: nothing is saved.
        what: kind of study.
        problem: by which the folder is recognised.
    """
    if folder is None:
        yield
    else:
        with use_store(Store.open(folder, what, in_texts(problem))):
            yield


@contextmanager
def use_store(store: Store | None) -> Iterator[None]:
    """All samples that are computed within are kept in a store."""
    token = CURRENT.set(store)
    try:
        yield
    except KeyboardInterrupt:
        if store is None:
            raise
        raise KeyboardInterrupt(
            f"The study was interrupted. What it had computed is kept in {store.folder}; ask the "
            "same again, and it goes on from there."
        ) from None
    finally:
        CURRENT.reset(token)
    if store is not None:
        store.tidy()


def stored(what: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Of a study of this kind, whose first argument is a problem: with `store`, a folder, the
    samples that it computes are kept there, and taken from there."""

    def decorate(study: Callable[P, R]) -> Callable[P, R]:
        first = next(iter(inspect.signature(study).parameters))

        @functools.wraps(study)
        def run(*arguments: P.args, **options: P.kwargs) -> R:
            folder = options.get("store")
            if folder is None:
                return study(*arguments, **options)
            problem: Any = arguments[0] if arguments else options.get(first)
            expect(problem, Problem, f"the {first} of {what}", "a problem, for its store")
            with open_store(folder, what, problem):
                return study(*arguments, **options)

        return run

    return decorate
