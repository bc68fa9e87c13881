"""A folder in which a study keeps what it has computed, so that an interrupted one goes on.

Zarr, written and read through xarray: arrays and text, nothing that is run when it is read. The
folder knows the problem by a text for each of its parts, and is refused for another one. Records
are kept with the numbers that they were computed from: asked for the same in the same order, a
study takes them from here, bit for bit; from the first that differs on, it computes anew.
"""

import importlib.util
import json
import shutil
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxclear.ground.wording import described

# Names of the two groups in the folder, and of the array of records.
RECORDS, RESULT, NUMBERS = "records.zarr", "result.zarr", "numbers"
# In front of every record that was written to its end.
WHOLE = 1.0


class Store:
    """Records of a study in a folder. `what`: the kind of study, in words; `texts` describe the
    problem, part by part."""

    def __init__(self, folder: Path, what: str, texts: dict[str, str], rows: np.ndarray):
        self.folder, self.what, self.texts, self.rows = folder, what, texts, rows
        self.place = 0

    @classmethod
    def opened(cls, folder: Any, what: str, texts: dict[str, str]) -> "Store":
        """The store in a folder, which is made where there is none. Raises `ValueError` with a
        sentence where it holds something else, `ImportError` without zarr."""
        folder = checked_folder(folder)
        before = folder / f".{RECORDS}.before"
        if before.exists() and not (folder / RECORDS).exists():
            before.rename(folder / RECORDS)
        if not (folder / RECORDS).exists():
            if folder.exists() and any(not path.name.startswith(".") for path in folder.iterdir()):
                raise ValueError(
                    f"the folder {folder} is not empty and holds no study; give another one."
                )
            return cls(folder, what, texts, np.zeros((0, 0)))
        kept, rows = _read(folder / RECORDS)
        refuse_other(folder, kept, what, texts)
        return cls(folder, what, texts, rows)

    def taken(self, begun: np.ndarray, kind: Any) -> Any:
        """The next record, if it was computed from the same numbers; otherwise None, and what
        follows in the folder is out of date. `kind`: the record with shapes in place of arrays."""
        leaves, tree = jax.tree.flatten(kind)
        sizes = [int(np.prod(leaf.shape)) for leaf in leaves]
        width = 1 + len(begun) + sum(sizes)
        if self.place >= len(self.rows):
            return None
        row = self.rows[self.place]
        first = 1 + len(begun)
        if len(row) != width or not np.array_equal(row[1:first], begun):
            self.rows = self.rows[: self.place]
            return None
        self.place += 1
        parts = np.split(row[first:], np.cumsum(sizes)[:-1])
        arrays = [
            part.reshape(leaf.shape).astype(leaf.dtype)
            for part, leaf in zip(parts, leaves, strict=True)
        ]
        return jax.tree.unflatten(tree, arrays)

    def add(self, begun: np.ndarray, record: Any) -> None:
        """Keeps a record that was computed from these numbers."""
        parts = [np.asarray(leaf, float).ravel() for leaf in jax.tree.leaves(record)]
        row = np.concatenate([[WHOLE], begun, *parts])
        current = self.place and self.place == self._rows_there()
        self.rows = np.vstack([self.rows, row]) if self.place else row[None]
        self.place += 1
        if current:
            self._dataset(row[None]).to_zarr(
                self.folder / RECORDS, append_dim="record", consolidated=False
            )
        else:
            self._written_anew(len(row))

    def conclude(self, result: Any) -> None:
        """Keeps the study's result, an xarray Dataset, beside its records."""
        self.folder.mkdir(parents=True, exist_ok=True)
        result.to_zarr(self.folder / RESULT, mode="w", consolidated=False)

    def _rows_there(self) -> int:
        """Records that the folder holds, those that were not written to their end too: what follows
        these would not be found again."""
        if not (self.folder / RECORDS).exists():
            return 0
        import zarr

        kept: Any = zarr.open_group(self.folder / RECORDS, mode="r")
        return kept[NUMBERS].shape[0]

    def _written_anew(self, width: int) -> None:
        """All records, beside those that are there until they are whole."""
        self.folder.mkdir(parents=True, exist_ok=True)
        beside, before = self.folder / f".{RECORDS}.new", self.folder / f".{RECORDS}.before"
        encoding = {NUMBERS: {"chunks": (1, width)}}
        self._dataset(self.rows).to_zarr(beside, mode="w", consolidated=False, encoding=encoding)
        shutil.rmtree(before, ignore_errors=True)
        if (self.folder / RECORDS).exists():
            (self.folder / RECORDS).rename(before)
        beside.rename(self.folder / RECORDS)
        shutil.rmtree(before, ignore_errors=True)

    def _dataset(self, rows: np.ndarray) -> Any:
        import xarray

        attributes = {"what": self.what, "problem": json.dumps(self.texts)}
        return xarray.Dataset({NUMBERS: (("record", "number"), rows)}, attrs=attributes)


def _read(path: Path) -> tuple[dict, np.ndarray]:
    """(attributes, records that were written to their end) of a folder."""
    import xarray

    with xarray.open_zarr(path, consolidated=False) as kept:
        rows = kept[NUMBERS].to_numpy()
        attributes = dict(kept.attrs)
    broken = np.flatnonzero(rows[:, 0] != WHOLE)
    return attributes, rows[: broken[0]] if len(broken) else rows


def checked_folder(folder: Any) -> Path:
    """The path of a folder in which a study is kept, or can be. Raises `ValueError` with a
    sentence, `ImportError` without zarr."""
    if importlib.util.find_spec("zarr") is None or importlib.util.find_spec("filelock") is None:
        raise ImportError('a store needs zarr: python -m pip install "jaxclear[store]".')
    if not isinstance(folder, (str, Path)) or not str(folder):
        raise ValueError(f"store is {described(folder)}; it must be the path of a folder.")
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"the store {folder} is a file; give a folder.")
    return folder


class OtherStudy(ValueError):
    """A folder holds another study than the one that is to go on there."""


def refuse_other(folder: Path, kept: dict[str, Any], what: str, texts: dict[str, str]) -> None:
    """Raises `OtherStudy` with a sentence where what a folder says of itself is another kind of
    study than `what`, or of a problem that differs from these texts."""
    if kept.get("what") != what:
        raise OtherStudy(
            f"the folder {folder} holds {kept.get('what')}, not {what}; give another one."
        )
    found = first_difference(json.loads(kept["problem"]), texts)
    if found:
        raise OtherStudy(
            f"the folder {folder} holds {what} of another problem: {found}. Give another "
            "folder, or delete this one."
        )


def first_difference(one: dict[str, str], other: dict[str, str]) -> str:
    """The first part in which two descriptions differ, in words; "" where they are the same."""
    for part in [*one, *(name for name in other if name not in one)]:
        mine, others = (_kept(own.get(part, "absent")) for own in (one, other))
        if mine != others:
            return f"{part} is {mine} there, {others} here"
    return ""


def _kept(text: str) -> str:
    """A text as it is told today; up to 0.30 parts of a mechanism were an OrderedDict."""
    return "dict" if text == "OrderedDict" else text
