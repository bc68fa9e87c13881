"""Whole chunks of Zarr arrays, written as Zarr writes them: the same bytes in the same files, each
written beside and renamed.

Zarr takes its event loop and threads for every chunk, however small: about a millisecond, ten times
as long as its codec and the file. A campaign writes one chunk of every array for each of its own.
What is not a whole chunk goes through Zarr itself, and so does all that is read.
"""

import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["ChunkFiles"]

# Numbers of numcodecs for the ways to shuffle that Zarr names.
SHUFFLES = {"noshuffle": 0, "shuffle": 1, "bitshuffle": 2}


class ChunkFiles:
    """The files of the arrays in a group, as `layout` makes them: chunks along the first axis, one
    codec (Blosc)."""

    def __init__(self, folder: Path, arrays: Mapping[str, Any]):
        self.folder, self.arrays = folder, arrays
        self.codecs = {name: _codec(array) for name, array in arrays.items()}

    def are_there(self, name: str, number: int) -> bool:
        """Whether a chunk of an array has been written."""
        return self._path(name, number).exists()

    def put(self, name: str, number: int, numbers: Any) -> None:
        """Writes a whole chunk of an array: rows (chunk, ...)."""
        array, path = self.arrays[name], self._path(name, number)
        rows = np.ascontiguousarray(numbers, array.dtype)
        if rows.shape != array.chunks:
            raise ValueError(f"{name} {rows.shape} are no whole chunk of {array.chunks}.")
        path.parent.mkdir(parents=True, exist_ok=True)
        beside = path.with_suffix(f".{secrets.token_hex(16)}.partial")
        try:
            beside.write_bytes(self.codecs[name].encode(rows))
            beside.replace(path)
        except BaseException:
            beside.unlink(missing_ok=True)
            raise

    def _path(self, name: str, number: int) -> Path:
        array = self.arrays[name]
        place = (number, *(0 for _ in array.chunks[1:]))
        return self.folder / name / array.metadata.encode_chunk_key(place)


def _codec(array: Any) -> Any:
    """What compresses the chunks of an array."""
    from numcodecs.blosc import Blosc

    # Attributes are enumerations or text, as the version of Zarr has it; here it is text.
    (own,) = array.compressors
    told = own.to_dict()["configuration"]
    return Blosc(**told | {"shuffle": SHUFFLES[told["shuffle"]]})
