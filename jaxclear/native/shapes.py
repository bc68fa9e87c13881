"""Rules for primitives that move numbers about, read by index or add up: see `rules`."""

import math

import numpy as np

from jaxclear.native.rules import array_of, rule
from jaxclear.native.writer import (
    FLOAT,
    LONGEST_IN_REGISTERS,
    InMemory,
    Unsupported,
    kind_of,
)


@rule(
    "copy",
    "copy_p",
    "stop_gradient",
    "optimization_barrier",
    "reduce_precision",
    reads_memory=True,
)
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


@rule("unstack")
def _unstack(writer, equation, a):
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
def _own_sample(writer, equation, a):
    """Equinox: whether one sample of a batch (all of them) wants it; in a kernel every sample goes
    its own way.
    """
    return a


@rule("select_if_vmap")
def _select_if(writer, equation, which, yes, no):
    """Equinox: guards samples of a batch that have ended, which the loop does here."""
    return yes
