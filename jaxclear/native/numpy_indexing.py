"""Slices, and reading and writing by index, as NumPy does them: see `by_numpy`."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jax.lax import GatherScatterMode

CLIPS = (GatherScatterMode.CLIP, GatherScatterMode.PROMISE_IN_BOUNDS)


def sliced(p: dict) -> Callable:
    """What `slice` does by its parameters."""
    strides = p["strides"] or (None,) * len(p["start_indices"])
    spans = tuple(map(slice, p["start_indices"], p["limit_indices"], strides))
    return lambda a: np.asarray(a)[spans]


def _window(starts: Any, sizes: Any) -> tuple[slice, ...]:
    return tuple(slice(int(s), int(s) + n) for s, n in zip(starts, sizes, strict=True))


def _within(starts: Any, shape: Any, sizes: Any) -> Any:
    """Starts of a window, moved so that it lies in an array of this shape."""
    return np.clip(np.asarray(starts, int), 0, np.subtract(shape, sizes).astype(int))


def dynamic_slice(p: dict) -> Callable:
    """What `dynamic_slice` does by its parameters."""
    sizes = p["slice_sizes"]
    return lambda a, *starts: a[_window(_within(starts, a.shape, sizes), sizes)]


def dynamic_update(a: Any, update: Any, *starts: Any) -> np.ndarray:
    """What `dynamic_update_slice` does."""
    out = np.array(a)
    out[_window(_within(starts, a.shape, update.shape), update.shape)] = update
    return out


def gather(p: dict) -> Callable | None:
    """What `gather` does by its parameters; None where it is one of a kind that is not here."""
    numbers, sizes = p["dimension_numbers"], p["slice_sizes"]
    if numbers.operand_batching_dims or p["mode"] not in CLIPS:
        return None

    def read(a, indices):
        batch, rank = indices.shape[:-1], indices.ndim - 1
        kept = [n for i, n in enumerate(sizes) if i not in numbers.collapsed_slice_dims]
        out = np.empty((*batch, *kept), a.dtype)
        for place in np.ndindex(*batch):
            starts = np.zeros(a.ndim, int)
            starts[list(numbers.start_index_map)] = indices[place]
            window = a[_window(_within(starts, a.shape, sizes), sizes)]
            out[place] = window.reshape(kept)
        inner = range(rank, rank + len(kept))
        return np.moveaxis(out, inner, numbers.offset_dims) if kept else out

    return read


def scatter(p: dict, add: bool) -> Callable | None:
    """What `scatter` or `scatter-add` does by its parameters; None where it is one of a kind that
    is not here."""
    numbers = p["dimension_numbers"]
    if numbers.operand_batching_dims:
        return None

    def write(a, indices, update):
        out, batch = np.array(a), indices.shape[:-1]
        inner = range(len(batch), update.ndim)
        update = np.moveaxis(update, numbers.update_window_dims, inner) if inner else update
        sizes = np.ones(a.ndim, int)
        kept = [i for i in range(a.ndim) if i not in numbers.inserted_window_dims]
        sizes[kept] = update.shape[len(batch) :]
        for place in np.ndindex(*batch):
            starts = np.zeros(a.ndim, int)
            starts[list(numbers.scatter_dims_to_operand_dims)] = indices[place]
            inside = _within(starts, a.shape, sizes)
            if p["mode"] not in CLIPS and np.any(inside != starts):
                continue
            spans, new = _window(inside, sizes), np.reshape(update[place], sizes)
            out[spans] = out[spans] + new if add else new
        return out

    return write
