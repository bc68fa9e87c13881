"""Rules for primitives that move numbers about, read by index or add up: see `rules`."""

import itertools
import math
from typing import Any

import numpy as np

from jaxclear.native.rules import array_of, compare, known, rule
from jaxclear.native.writer import (
    FLOAT,
    LONGEST_IN_REGISTERS,
    TRUTH,
    WHOLE,
    InMemory,
    Unsupported,
    kind_of,
)


@rule("copy", "copy_p", "stop_gradient", "optimization_barrier", "reduce_precision")
def _same(writer, equation, *arrays):
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
    return InMemory(a.places, tuple(new)) if isinstance(a, InMemory) else a.reshape(new)


@rule("squeeze", reads_memory=True)
def _squeeze(writer, equation, a):
    shape = equation.outvars[0].aval.shape
    return InMemory(a.places, shape) if isinstance(a, InMemory) else a.reshape(shape)


@rule("expand_dims")
def _expand(writer, equation, a):
    return a.reshape(equation.outvars[0].aval.shape)


@rule("transpose")
def _transpose(writer, equation, a):
    return a.transpose(equation.params["permutation"])


@rule("rev")
def _reverse(writer, equation, a):
    return np.flip(a, equation.params["dimensions"])


@rule("slice", reads_memory=True)
def _slice(writer, equation, a):
    p = equation.params
    strides = p["strides"] or (1,) * len(p["start_indices"])
    spans = tuple(
        slice(*s) for s in zip(p["start_indices"], p["limit_indices"], strides, strict=True)
    )
    if isinstance(a, InMemory):
        wanted = np.arange(math.prod(a.shape)).reshape(a.shape)[spans]
        if wanted.size > LONGEST_IN_REGISTERS:
            raise Unsupported("a long slice of an array in memory")
        return array_of([writer.read(a, int(i)) for i in wanted.flat], (wanted.size,)).reshape(
            wanted.shape
        )
    return a[spans]


@rule("concatenate")
def _concatenate(writer, equation, *arrays):
    return np.concatenate(arrays, equation.params["dimension"])


@rule("stack")
def _stack(writer, equation, *arrays):
    return np.stack(arrays, equation.params["axis"])


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


def _pair(writer, name, kind, x, y):
    """Sum, product, extremum, and, or of two numbers."""
    if kind == FLOAT and name in ("sum", "prod"):
        if known(x, y):
            return x + y if name == "sum" else x * y
        return writer.operate(
            ("fadd" if name == "sum" else "fmul") + " contract {type} {0}, {1}", kind, x, y
        )
    if kind == TRUTH:
        if known(x, y):
            return (x or y) if name in ("or", "max") else (x and y)
        return writer.operate(
            ("or" if name in ("or", "max") else "and") + " {type} {0}, {1}", kind, x, y
        )
    if name in ("max", "min"):
        first = compare(writer, "gt" if name == "max" else "lt", kind, x, y)
        if kind == FLOAT and isinstance(x, str):
            lost = writer.operate("fcmp uno {type} {0}, {0}", kind, x)
            first = writer.operate("or {type} {0}, {1}", TRUTH, first, lost)
        return writer.choose(first, x, y, kind)
    if kind == WHOLE and name in ("sum", "prod"):
        return writer.operate(("add" if name == "sum" else "mul") + " {type} {0}, {1}", kind, x, y)
    raise Unsupported(f"the reduction {name}")


_NEUTRAL = {"sum": 0, "prod": 1, "and": True, "or": False, "max": -math.inf, "min": math.inf}


@rule("reduce_sum", "reduce_prod", "reduce_max", "reduce_min", "reduce_and", "reduce_or")
def _reduce(writer, equation, a):
    name, kind = (
        equation.primitive.name.removeprefix("reduce_"),
        kind_of(equation.invars[0].aval.dtype),
    )
    a, axes = a, equation.params["axes"]
    rest = [i for i in range(a.ndim) if i not in axes]
    rows = a.transpose([*rest, *axes]).reshape([a.shape[i] for i in rest] + [-1])
    out = np.empty(rows.shape[:-1], object)
    for index in np.ndindex(*out.shape):
        row = list(rows[index])
        if not row:
            if kind == WHOLE and name in ("max", "min"):
                raise Unsupported(f"a {name} over no whole numbers")
            out[index] = {FLOAT: float, WHOLE: int, TRUTH: bool}[kind](_NEUTRAL[name])
            continue
        total = row[0]
        for value in row[1:]:
            total = _pair(writer, name, kind, total, value)
        out[index] = total
    return out


@rule("dot_general")
def _dot(writer, equation, a, b):
    (left, right), (batch_left, batch_right) = equation.params["dimension_numbers"]
    if kind_of(equation.outvars[0].aval.dtype) != FLOAT:
        raise Unsupported("a product of whole matrices")
    free_a = [i for i in range(a.ndim) if i not in (*left, *batch_left)]
    free_b = [i for i in range(b.ndim) if i not in (*right, *batch_right)]
    a = a.transpose([*batch_left, *free_a, *left])
    b = b.transpose([*batch_right, *free_b, *right])
    batch = a.shape[: len(batch_left)]
    shape_a, shape_b = (
        a.shape[len(batch) : len(batch) + len(free_a)],
        b.shape[len(batch) : len(batch) + len(free_b)],
    )
    out = np.empty(batch + shape_a + shape_b, object)
    for index in np.ndindex(*batch):
        for i in np.ndindex(*shape_a):
            for j in np.ndindex(*shape_b):
                total: Any = 0.0
                for x, y in zip(a[index + i].flat, b[index + j].flat, strict=True):
                    product = writer.operate("fmul contract {type} {0}, {1}", FLOAT, x, y)
                    total = product if known(total) else _pair(writer, "sum", FLOAT, total, product)
                out[index + i + j] = total
    return out


def _within(writer, index, largest):
    """An index moved into 0 ... largest."""
    if known(index):
        return min(max(index, 0), largest)
    low = writer.choose(compare(writer, "lt", WHOLE, index, 0), 0, index, WHOLE)
    return writer.choose(compare(writer, "gt", WHOLE, low, largest), largest, low, WHOLE)


def _entry(writer, array, index, kind):
    """array[index] for a tuple of indices within range, some known only at run time."""
    shape = array.shape
    if isinstance(array, InMemory):
        strides = [math.prod(shape[i + 1 :]) for i in range(len(shape))]
        flat: Any = sum(i * s for i, s in zip(index, strides, strict=True) if known(i))
        for i, stride in zip(index, strides, strict=True):
            if not known(i):
                part = i if stride == 1 else writer.operate("mul {type} {0}, {1}", WHOLE, i, stride)
                flat = (
                    part if flat == 0 else writer.operate("add {type} {0}, {1}", WHOLE, flat, part)
                )
        return writer.read(array, flat)
    for axis, i in enumerate(index):
        if not known(i):
            found = None
            for choice in range(shape[axis]):
                value = _entry(writer, array, (*index[:axis], choice, *index[axis + 1 :]), kind)
                found = (
                    value
                    if found is None
                    else writer.choose(compare(writer, "eq", WHOLE, i, choice), value, found, kind)
                )
            return found
    return array[tuple(index)]


def _plus(writer, x, y):
    if known(x, y):
        return x + y
    return x if known(y) and y == 0 else writer.operate("add {type} {0}, {1}", WHOLE, x, y)


@rule("dynamic_slice", reads_memory=True)
def _dynamic_slice(writer, equation, a, *starts):
    sizes, kind = equation.params["slice_sizes"], kind_of(equation.invars[0].aval.dtype)
    starts = [
        _within(writer, s.item(), full - size)
        for s, full, size in zip(starts, a.shape, sizes, strict=True)
    ]
    if math.prod(sizes) > LONGEST_IN_REGISTERS:
        raise Unsupported("a long slice")
    out = np.empty(sizes, object)
    for index in np.ndindex(*sizes):
        out[index] = _entry(
            writer, a, tuple(_plus(writer, s, i) for s, i in zip(starts, index, strict=True)), kind
        )
    return out


@rule("dynamic_update_slice")
def _dynamic_update(writer, equation, a, update, *starts):
    starts = [
        _within(writer, s.item(), full - n)
        for s, full, n in zip(starts, a.shape, update.shape, strict=True)
    ]
    out = a.copy()
    for index in np.ndindex(*update.shape):
        place = tuple(_plus(writer, s, i) for s, i in zip(starts, index, strict=True))
        _put_entry(writer, out, place, update[index], kind_of(equation.invars[0].aval.dtype))
    return out


def _put_entry(writer, out, place, value, kind):
    """out[place] = value, where within the array; some indices may be known only at run time."""
    choices = [
        range(n) if not known(i) else ([i] if 0 <= i < n else [])
        for i, n in zip(place, out.shape, strict=True)
    ]
    for target in itertools.product(*choices):
        here: Any = True
        for i, at in zip(place, target, strict=True):
            if not known(i):
                key = ("at", i, at)
                test = writer.once(key, lambda i=i, at=at: compare(writer, "eq", WHOLE, i, at))
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


@rule("unvmap_any", "unvmap_all", "nonbatchable")
def _own_sample(writer, equation, a):
    """Equinox: whether one sample of a batch (all of them) wants it; in a kernel every sample goes
    its own way.
    """
    return a


@rule("select_if_vmap")
def _select_if(writer, equation, which, yes, no):
    """Equinox: guards samples of a batch that have ended, which the loop does here."""
    return yes


@rule("gather", reads_memory=True)
def _gather(writer, equation, a, indices):
    p, kind = equation.params, kind_of(equation.invars[0].aval.dtype)
    numbers, sizes = p["dimension_numbers"], p["slice_sizes"]
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
            place[axis] = _within(writer, indices[(*batch, where)], a.shape[axis] - sizes[axis])
        for axis, offset in zip(window, inside, strict=True):
            place[axis] = _plus(writer, place[axis], offset)
        out[index] = _entry(writer, a, tuple(place), kind)
    return out


@rule("scatter", "scatter-add")
def _scatter(writer, equation, a, indices, update):
    numbers, add = equation.params["dimension_numbers"], equation.primitive.name != "scatter"
    if numbers.operand_batching_dims or "CLIP" in str(equation.params["mode"]):
        raise Unsupported("this kind of scatter")
    kind, out = kind_of(equation.invars[0].aval.dtype), a.copy()
    window = [i for i in range(a.ndim) if i not in numbers.inserted_window_dims]
    for index in np.ndindex(*update.shape):
        batch = tuple(x for i, x in enumerate(index) if i not in numbers.update_window_dims)
        inside = [x for i, x in enumerate(index) if i in numbers.update_window_dims]
        place: list[Any] = [0] * a.ndim
        for where, axis in enumerate(numbers.scatter_dims_to_operand_dims):
            place[axis] = indices[(*batch, where)]
        for axis, offset in zip(window, inside, strict=True):
            place[axis] = _plus(writer, place[axis], offset)
        if not add:
            _put_entry(writer, out, tuple(place), update[index], kind)
        elif known(*place) and all(0 <= i < n for i, n in zip(place, a.shape, strict=True)):
            out[tuple(place)] = _pair(writer, "sum", kind, out[tuple(place)], update[index])
        else:
            raise Unsupported("an addition at a place known only at run time")
    return out
