"""Rules for primitives that move numbers about, and for reading and writing arrays by index, where
indices may be known only at run time.

An entry of an array in registers is then chosen among all of them; one of an array in memory is
loaded from its place.
"""

import itertools
import math
from typing import Any

import numpy as np

from jaxclear.native.arithmetic import combine, compare
from jaxclear.native.long_arrays import join_arrays, unstack_rows, view
from jaxclear.native.writer import (
    FLOAT,
    INT,
    LONGEST_IN_REGISTERS,
    TRUTH,
    InMemory,
    Unsupported,
    array_of,
    is_num,
    kind_of,
    refuse_memory,
    rule,
)


@rule(
    "copy", "copy_p", "stop_gradient", "optimization_barrier", "reduce_precision", reads_memory=True
)
def _pass_through(writer, equation, *arrays):
    return list(arrays)


@rule("broadcast_in_dim")
def _broadcast(writer, equation, a):
    shape, places = equation.params["shape"], equation.params["broadcast_dimensions"]
    wide = [1] * len(shape)
    for place, size in zip(places, a.shape, strict=True):
        wide[place] = size
    return np.broadcast_to(a.reshape(wide), shape)


@rule("reshape", reads_memory=True)
def _reshape(writer, equation, a):
    new = equation.params["new_sizes"]
    return a.reshaped(tuple(new)) if isinstance(a, InMemory) else a.reshape(new)


@rule("squeeze", reads_memory=True)
def _squeeze(writer, equation, a):
    shape = equation.outvars[0].aval.shape
    return a.reshaped(shape) if isinstance(a, InMemory) else a.reshape(shape)


@rule("expand_dims")
def _expand(writer, equation, a):
    return a.reshape(equation.outvars[0].aval.shape)


@rule("transpose", reads_memory=True)
def _transpose(writer, equation, a):
    if isinstance(a, InMemory):
        # A table of coefficients that all of it is made of: the instructions are counted anyway.
        entries = [writer.read(a, i) for i in range(math.prod(a.shape))]
        a = array_of(entries, (len(entries),)).reshape(a.shape)
    return a.transpose(equation.params["permutation"])


@rule("rev")
def _reverse(writer, equation, a):
    return np.flip(a, equation.params["dimensions"])


def spans_of(equation: Any) -> tuple[slice, ...]:
    """What a slice takes of each axis."""
    p = equation.params
    strides = p["strides"] or (1,) * len(p["start_indices"])
    return tuple(
        slice(*s) for s in zip(p["start_indices"], p["limit_indices"], strides, strict=True)
    )


@rule("slice", reads_memory=True)
def _slice(writer, equation, a):
    spans = spans_of(equation)
    if isinstance(a, InMemory):
        selected = np.arange(math.prod(a.shape)).reshape(a.shape)[spans]
        return view(writer, a, kind_of(equation.invars[0].aval.dtype), selected)
    return a[spans]


@rule("concatenate", reads_memory=True)
def _concatenate(writer, equation, *arrays):
    if any(isinstance(a, InMemory) for a in arrays):
        kind = kind_of(equation.outvars[0].aval.dtype)
        return join_arrays(writer, arrays, kind, equation.params["dimension"])
    return np.concatenate(arrays, equation.params["dimension"])


@rule("pad")
def _pad(writer, equation, a, value):
    """Entries put around and between those of an array; at an edge a negative count cuts off."""
    config = equation.params["padding_config"]
    spread = array_of(
        value[()], tuple(n + max(n - 1, 0) * c[2] for n, c in zip(a.shape, config, strict=True))
    )
    spread[tuple(slice(None, None, c[2] + 1) for c in config)] = a
    widths = [(max(low, 0), max(high, 0)) for low, high, _ in config]
    wide = array_of(value[()], tuple(n + sum(w) for n, w in zip(spread.shape, widths, strict=True)))
    inner = tuple(slice(w[0], w[0] + n) for n, w in zip(spread.shape, widths, strict=True))
    wide[inner] = spread
    cut = [
        (max(-low, 0), n - max(-high, 0))
        for n, (low, high, _) in zip(wide.shape, config, strict=True)
    ]
    return wide[tuple(slice(*c) for c in cut)]


@rule("stack")
def _stack(writer, equation, *arrays):
    return np.stack(arrays, equation.params["axis"])


@rule("unstack", reads_memory=True)
def _unstack(writer, equation, a):
    if isinstance(a, InMemory):
        places = np.moveaxis(
            np.arange(math.prod(a.shape)).reshape(a.shape), equation.params["axis"], 0
        )
        return unstack_rows(writer, equation, a, FLOAT, places)
    rows = np.split(a, len(equation.outvars), equation.params["axis"])
    return [row.reshape(atom.aval.shape) for row, atom in zip(rows, equation.outvars, strict=True)]


@rule("split")
def _split(writer, equation, a):
    return np.split(a, np.cumsum(equation.params["sizes"])[:-1], equation.params["axis"])


@rule("iota")
def _iota(writer, equation):
    shape, axis = equation.params["shape"], equation.params["dimension"]
    make = float if kind_of(equation.params["dtype"]) == FLOAT else int
    row = np.arange(shape[axis]).reshape([-1 if i == axis else 1 for i in range(len(shape))])
    out = np.empty(shape, object)
    for index in np.ndindex(*shape):
        out[index] = make(np.broadcast_to(row, shape)[index])
    return out


@rule("unvmap_any", "unvmap_all", "nonbatchable")
def _pass_sample(writer, equation, a):
    """Equinox: whether one sample of a batch (all of them) wants it; in a kernel every sample goes
    its own way.
    """
    return a


@rule("select_if_vmap")
def _select_if(writer, equation, which, yes, no):
    """Equinox: guards samples of a batch that have ended, which the loop does here."""
    return yes


def _clamp(writer, index, largest):
    """An index moved into 0 ... largest."""
    if is_num(index):
        return min(max(index, 0), largest)
    low = writer.choose(compare(writer, "lt", INT, index, 0), 0, index, INT)
    return writer.choose(compare(writer, "gt", INT, low, largest), largest, low, INT)


def _read(writer, array, index, kind):
    """array[index] for a tuple of indices within range, some known only at run time."""
    shape = array.shape
    if isinstance(array, InMemory):
        return writer.read(array, _flat(writer, shape, index))
    for axis, i in enumerate(index):
        if not is_num(i):
            entry = None
            for choice in range(shape[axis]):
                value = _read(writer, array, (*index[:axis], choice, *index[axis + 1 :]), kind)
                entry = (
                    value
                    if entry is None
                    else writer.choose(compare(writer, "eq", INT, i, choice), value, entry, kind)
                )
            return entry
    return array[tuple(index)]


def _flat(writer, shape, index):
    """The row-major index of an entry."""
    strides = [math.prod(shape[i + 1 :]) for i in range(len(shape))]
    flat: Any = sum(i * s for i, s in zip(index, strides, strict=True) if is_num(i))
    for i, stride in zip(index, strides, strict=True):
        if not is_num(i):
            part = i if stride == 1 else writer.operate("mul {type} {0}, {1}", INT, i, stride)
            flat = part if flat == 0 else writer.operate("add {type} {0}, {1}", INT, flat, part)
    return flat


def _add(writer, x, y):
    if is_num(x, y):
        return x + y
    return x if is_num(y) and y == 0 else writer.operate("add {type} {0}, {1}", INT, x, y)


@rule("dynamic_slice", reads_memory=True)
def _dynamic_slice(writer, equation, a, *starts):
    sizes, kind = equation.params["slice_sizes"], kind_of(equation.invars[0].aval.dtype)
    starts = [
        _clamp(writer, s.item(), full - size)
        for s, full, size in zip(starts, a.shape, sizes, strict=True)
    ]
    if math.prod(sizes) > LONGEST_IN_REGISTERS:
        if isinstance(a, InMemory) and a.version is None and tuple(sizes[1:]) == a.shape[1:]:
            # Whole rows of a table: they stand where they stand.
            return writer.part(a, _flat(writer, a.shape, starts), tuple(sizes))
        raise Unsupported("a long slice")
    out = np.empty(sizes, object)
    for index in np.ndindex(*sizes):
        out[index] = _read(
            writer, a, tuple(_add(writer, s, i) for s, i in zip(starts, index, strict=True)), kind
        )
    return out


@rule("dynamic_update_slice", reads_memory=True)
def _dynamic_update(writer, equation, a, update, *starts):
    starts = [
        _clamp(writer, s.item(), full - n)
        for s, full, n in zip(starts, a.shape, update.shape, strict=True)
    ]
    places = {
        index: tuple(_add(writer, s, i) for s, i in zip(starts, index, strict=True))
        for index in np.ndindex(*update.shape)
    }
    return _update_entries(writer, a, update, places, kind_of(equation.invars[0].aval.dtype))


def _update_entries(writer, a, update, places, kind):
    """An array with the entries of an update at their places, all of them within it."""
    refuse_memory(update)
    if isinstance(a, InMemory):
        at = [(_flat(writer, a.shape, place), update[index]) for index, place in places.items()]
        return writer.change(a, at)
    out = a.copy()
    for index, place in places.items():
        _put_entry(writer, out, place, update[index], kind)
    return out


def _put_entry(writer, out, place, value, kind):
    """out[place] = value, where within the array; some indices may be known only at run time."""
    choices = [
        range(n) if not is_num(i) else ([i] if 0 <= i < n else [])
        for i, n in zip(place, out.shape, strict=True)
    ]
    for target in itertools.product(*choices):
        here: Any = True
        for i, at in zip(place, target, strict=True):
            if not is_num(i):
                test = compare(writer, "eq", INT, i, at)
                here = (
                    test
                    if here is True
                    else writer.operate("and {type} {0}, {1}", TRUTH, here, test)
                )
        out[target] = writer.choose(here, value, out[target], kind)


@rule("maybe_set")
def _maybe_set(writer, equation, allowed, a, update, *indices):
    """Equinox: a.at[i].set(update); `allowed` only guards samples of a batch that have ended, which
    the loop does here.
    """
    p = equation.params
    if len(indices) != 1 or p["i_static"] is not None or indices[0].shape != () or p["kwargs"]:
        raise Unsupported("this kind of update")
    out, kind = a.copy(), kind_of(equation.invars[1].aval.dtype)
    for index in np.ndindex(*update.shape):
        _put_entry(writer, out, (indices[0].item(), *index), update[index], kind)
    return out


def gathered_places(equation: Any, shape: tuple[int, ...], indices: Any) -> np.ndarray | None:
    """Row-major places of gathered entries in an array; None where indices are not known.

    Args:
        equation: of JAX's primitive `gather`.
        shape: of the array.
        indices: start indices, an array of registers or numbers.
    """
    p = equation.params
    numbers, sizes = p["dimension_numbers"], p["slice_sizes"]
    plain = not numbers.operand_batching_dims and "FILL" not in str(p["mode"])
    if not plain or not is_num(*indices.flat):
        return None
    starts = np.array(indices.tolist(), int).reshape(indices.shape)
    window = [i for i in range(len(sizes)) if i not in numbers.collapsed_slice_dims]
    out = np.indices(equation.outvars[0].aval.shape)
    batch = tuple(x for i, x in enumerate(out) if i not in numbers.offset_dims)
    place: list[Any] = [np.zeros(out.shape[1:], int) for _ in sizes]
    for where, axis in enumerate(numbers.start_index_map):
        place[axis] = np.clip(starts[(*batch, where)], 0, shape[axis] - sizes[axis])
    for axis, offset in zip(window, numbers.offset_dims, strict=True):
        place[axis] = place[axis] + out[offset]
    return np.ravel_multi_index(tuple(place), shape)


@rule("gather", reads_memory=True)
def _gather(writer, equation, a, indices):
    p, kind = equation.params, kind_of(equation.invars[0].aval.dtype)
    numbers, sizes = p["dimension_numbers"], p["slice_sizes"]
    places = gathered_places(equation, a.shape, indices) if isinstance(a, InMemory) else None
    if places is not None:
        return view(writer, a, kind, places)
    if numbers.operand_batching_dims or "FILL" in str(p["mode"]):
        raise Unsupported("this kind of gather")
    out_shape = equation.outvars[0].aval.shape
    window = [i for i in range(len(sizes)) if i not in numbers.collapsed_slice_dims]
    out = np.empty(out_shape, object)
    for index in np.ndindex(*out_shape):
        batch = tuple(x for i, x in enumerate(index) if i not in numbers.offset_dims)
        inside = [x for i, x in enumerate(index) if i in numbers.offset_dims]
        place: list[Any] = [0] * len(sizes)
        for where, axis in enumerate(numbers.start_index_map):
            place[axis] = _clamp(writer, indices[(*batch, where)], a.shape[axis] - sizes[axis])
        for axis, offset in zip(window, inside, strict=True):
            place[axis] = _add(writer, place[axis], offset)
        out[index] = _read(writer, a, tuple(place), kind)
    return out


@rule("scatter", "scatter-add", reads_memory=True)
def _scatter(writer, equation, a, indices, update):
    numbers, add = equation.params["dimension_numbers"], equation.primitive.name != "scatter"
    clips = "CLIP" in str(equation.params["mode"])
    kind = kind_of(equation.invars[0].aval.dtype)
    if not clips or add:
        refuse_memory(a, indices, update)
    if numbers.operand_batching_dims or (clips and add):
        raise Unsupported("this kind of scatter")
    places = places_of(writer, numbers, a.shape, indices, update.shape, clips)
    if clips:
        return _update_entries(writer, a, update, places, kind)
    out = a.copy()
    for index, place in places.items():
        if not add:
            _put_entry(writer, out, place, update[index], kind)
        elif is_num(*place) and all(0 <= i < n for i, n in zip(place, a.shape, strict=True)):
            out[place] = combine(writer, "sum", kind, out[place], update[index])
        else:
            raise Unsupported("an addition at a place known only at run time")
    return out


def places_of(writer, numbers, shape, indices, updated, clips):
    """Index in an array of each entry of an update.

    Args:
        writer: LLVM text under construction.
        numbers: dimension numbers of JAX's scatter.
        shape: of the array.
        indices: start indices, an array of registers or numbers.
        updated: shape of the update.
        clips: whether windows are moved into the array as a whole, as for the update of a slice;
            otherwise entries outside are dropped.
    """
    window = [i for i in range(len(shape)) if i not in numbers.inserted_window_dims]
    sizes = dict.fromkeys(range(len(shape)), 1)
    sizes |= {i: updated[d] for i, d in zip(window, numbers.update_window_dims, strict=True)}
    places = {}
    for index in np.ndindex(*updated):
        batch = tuple(x for i, x in enumerate(index) if i not in numbers.update_window_dims)
        place: list[Any] = [0] * len(shape)
        for where, axis in enumerate(numbers.scatter_dims_to_operand_dims):
            start = indices[(*batch, where)]
            place[axis] = _clamp(writer, start, shape[axis] - sizes[axis]) if clips else start
        for axis, d in zip(window, numbers.update_window_dims, strict=True):
            place[axis] = _add(writer, place[axis], index[d])
        places[index] = tuple(place)
    return places
