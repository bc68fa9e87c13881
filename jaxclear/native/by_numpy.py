"""A program evaluated with NumPy, one operation after the other: what a kernel is checked against.

Independent of the rules that wrote the kernel. Operations that NumPy does not have under a plain
name are left to JAX.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal

from jaxclear.native import numpy_indexing
from jaxclear.native.calls import CALLS, called, is_an_error
from jaxclear.native.program import scan_counts
from jaxclear.native.writer import Unsupported

# Turns after which a loop within the loop is given up.
LONGEST_LOOP = 1000


def _select(which, *cases):
    return np.where(which, cases[1], cases[0]) if len(cases) == 2 else np.choose(which, cases)


def _rounded(p):
    return (
        np.rint if int(p["rounding_method"]) == 1 else lambda a: np.trunc(a + np.copysign(0.5, a))
    )


def _broadcast(p):
    def spread(a):
        if not p["shape"]:
            return a
        shape = [1] * len(p["shape"])
        for place, size in zip(p["broadcast_dimensions"], np.shape(a), strict=True):
            shape[place] = size
        return np.broadcast_to(np.reshape(a, shape), p["shape"])

    return spread


# What a primitive does, as it stands or given its parameters.
ON_FLOATS: dict[str, Callable] = {"div": np.divide, "rem": np.fmod}
PLAIN: dict[str, Callable] = {
    "add": np.add,
    "add_any": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "neg": np.negative,
    "max": np.maximum,
    "min": np.minimum,
    "abs": np.abs,
    "sign": np.sign,
    "square": np.square,
    "one_minus_square": lambda a: (1 + a) * (1 - a),
    "sqrt": np.sqrt,
    "sin": np.sin,
    "cos": np.cos,
    "exp": np.exp,
    "log": np.log,
    "tanh": np.tanh,
    "atan2": np.arctan2,
    "nextafter": np.nextafter,
    "pow": np.power,
    "floor": np.floor,
    "ceil": np.ceil,
    "cbrt": np.cbrt,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "log1p": np.log1p,
    "expm1": np.expm1,
    "rsqrt": lambda a: 1 / np.sqrt(a),
    "clamp": lambda low, a, high: np.minimum(np.maximum(a, low), high),
    "eq": np.equal,
    "ne": np.not_equal,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "not": np.invert,
    "select_n": _select,
    "is_finite": np.isfinite,
    "dynamic_update_slice": numpy_indexing.dynamic_update,
    "copy": np.asarray,
    "stop_gradient": np.asarray,
    # Equinox: what a single sample does.
    "unvmap_any": np.asarray,
    "nonbatchable": np.asarray,
    "select_if_vmap": lambda which, yes, no: yes,
}


def _counted(p):
    rows = np.arange(p["shape"][p["dimension"]], dtype=p["dtype"])
    return np.broadcast_to(
        rows.reshape([-1 if i == p["dimension"] else 1 for i in range(len(p["shape"]))]), p["shape"]
    )


def _range(a: Any) -> tuple[Any, Any]:
    """What a maximum and a minimum over nothing are."""
    kind = np.result_type(a)
    if np.issubdtype(kind, np.floating):
        return -np.inf, np.inf
    return np.iinfo(kind).min, np.iinfo(kind).max


WITH_PARAMETERS: dict[str, Callable] = {
    "integer_pow": lambda p: lambda a: np.asarray(a) ** float(p["y"]),
    "convert_element_type": lambda p: lambda a: np.asarray(a).astype(p["new_dtype"]),
    "bitcast_convert_type": lambda p: lambda a: np.asarray(a).view(p["new_dtype"]),
    "squeeze": lambda p: lambda a: np.squeeze(a, p["dimensions"]),
    "reshape": lambda p: lambda a: np.reshape(a, p["new_sizes"]),
    "stack": lambda p: lambda *a: np.stack(a, p["axis"]),
    "concatenate": lambda p: lambda *a: np.concatenate(a, p["dimension"]),
    "round": _rounded,
    "slice": numpy_indexing.sliced,
    "dynamic_slice": numpy_indexing.dynamic_slice,
    "broadcast_in_dim": _broadcast,
    "transpose": lambda p: lambda a: np.transpose(a, p["permutation"]),
    "rev": lambda p: lambda a: np.flip(a, p["dimensions"]),
    "iota": lambda p: lambda: _counted(p),
    "reduce_sum": lambda p: lambda a: np.sum(a, p["axes"]),
    "reduce_max": lambda p: lambda a: np.max(a, p["axes"], initial=_range(a)[0]),
    "reduce_min": lambda p: lambda a: np.min(a, p["axes"], initial=_range(a)[1]),
    "reduce_or": lambda p: lambda a: np.any(a, p["axes"]),
    "reduce_and": lambda p: lambda a: np.all(a, p["axes"]),
}


def evaluator(program: Any, known: dict | None = None) -> Callable[..., list]:
    """A function that gives a program's outputs, one NumPy operation after the other. `known`:
    inner programs met before.
    """
    known = {} if known is None else known
    closed = isinstance(program, ClosedJaxpr)
    jaxpr, constants = (program.jaxpr, program.consts) if closed else (program, [])
    if id(jaxpr) in known:
        return known[id(jaxpr)]
    slots = _Slots()
    for variable, value in zip(jaxpr.constvars, constants, strict=True):
        slots.values[slots.of(variable)] = np.asarray(value)
    entries = [slots.of(variable) for variable in jaxpr.invars]
    steps = []
    for equation in jaxpr.eqns:
        inputs = [slots.of(atom) for atom in equation.invars]
        outputs = [slots.of(atom) for atom in equation.outvars]
        steps.append((*_operation(equation, known), inputs, outputs))
    exits = [slots.of(atom) for atom in jaxpr.outvars]

    def run(*arguments):
        values = slots.values.copy()
        for place, value in zip(entries, arguments, strict=True):
            values[place] = value
        for function, several, inputs, outputs in steps:
            found = function(*[values[i] for i in inputs])
            for place, value in zip(outputs, found if several else [found], strict=True):
                values[place] = value
        return [np.asarray(values[place]) for place in exits]

    known[id(jaxpr)] = run
    return run


class _Slots:
    """A place for each variable and literal of a program; `values` holds what is known at first."""

    def __init__(self):
        self.values: list[Any] = []
        self._places: dict[Any, int] = {}

    def of(self, atom: Any) -> int:
        """The place of a variable, or a new one for a literal."""
        if isinstance(atom, Literal):
            kind: Any = atom.aval
            self.values.append(np.asarray(atom.val, kind.dtype))
            return len(self.values) - 1
        if atom not in self._places:
            self._places[atom] = len(self.values)
            self.values.append(None)
        return self._places[atom]


def _operation(equation: Any, known: dict) -> tuple[Callable, bool]:
    """What an equation does, and whether it gives a list."""
    name, p = equation.primitive.name, equation.params
    if name == "unstack":
        return lambda a: list(np.moveaxis(np.asarray(a), p["axis"], 0)), True
    if name in PLAIN:
        return PLAIN[name], False
    if name in WITH_PARAMETERS:
        return WITH_PARAMETERS[name](p), False
    if name in ON_FLOATS and np.issubdtype(equation.outvars[0].aval.dtype, np.floating):
        return ON_FLOATS[name], False
    if name == "rem":
        # Of whole numbers by 0 XLA gives the number itself.
        return lambda a, b: np.where(b == 0, a, np.fmod(a, b)), False
    if name == "scan" and not p["reverse"]:
        return _scan(p, evaluator(p["jaxpr"], known)), True
    if name == "cond":
        branches = [evaluator(branch, known) for branch in p["branches"]]
        return lambda which, *inputs: branches[int(which)](*inputs), True
    if name == "pure_callback" and is_an_error(p):
        shapes = [atom.aval.shape for atom in equation.outvars]
        return lambda *_: [np.full(shape, np.nan) for shape in shapes], True
    if name == "while":
        return _while(p, evaluator(p["cond_jaxpr"], known), evaluator(p["body_jaxpr"], known)), True
    if name == "jaxclear_loop" and not equation.params["rank"]:
        program = equation.params["program"]
        turn, constants = evaluator(program.body, known), program.condition_constants
        # As in a kernel under check: one turn.
        return lambda *inputs: turn(*inputs[constants:]), True
    if name == "dot_general" and not p["dimension_numbers"][1][0]:
        return lambda a, b: np.tensordot(a, b, axes=p["dimension_numbers"][0]), False
    if name == "maybe_set" and p["i_static"] is None:
        return _set, False
    if name in CALLS:
        return evaluator(called(p), known), True
    by_index = numpy_indexing.gather(p) if name == "gather" else None
    if name in ("scatter", "scatter-add"):
        by_index = numpy_indexing.scatter(p, add=name != "scatter")
    if by_index is not None:
        return by_index, False
    return lambda *inputs: [np.asarray(own) for own in _bound(equation, inputs)], True


def _scan(p: dict, turn: Callable) -> Callable:
    fixed, carried = scan_counts(p)

    def run(*inputs):
        carry, rows, given = inputs[fixed:][:carried], inputs[fixed + carried :], []
        for i in range(p["length"]):
            found = turn(*inputs[:fixed], *carry, *[row[i] for row in rows])
            carry = found[:carried]
            given.append(found[carried:])
        return [*carry, *[np.stack(parts) for parts in zip(*given, strict=True)]]

    return run


def _while(p: dict, unfinished: Callable, turn: Callable) -> Callable:
    first, second = p["cond_nconsts"], p["body_nconsts"]

    def run(*inputs):
        fixed, state = inputs[first : first + second], inputs[first + second :]
        for _ in range(LONGEST_LOOP):
            if not unfinished(*inputs[:first], *state)[0]:
                return state
            state = turn(*fixed, *state)
        raise Unsupported("a loop within the loop that does not end on random numbers")

    return run


def _set(_, array, value, *places):
    out = np.array(array)
    if len(places) == 1 and 0 <= int(places[0]) < len(out):
        out[int(places[0])] = value
    return out


def _bound(equation: Any, inputs: tuple) -> list:
    found = equation.primitive.bind(*map(jnp.asarray, inputs), **equation.params)
    return found if equation.primitive.multiple_results else [found]
