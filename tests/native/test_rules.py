"""Every rule by itself on awkward numbers, against JAX's own evaluation of the same primitive.

The cases of several rules stand in one loop of one turn, so that one kernel serves a single sample
and one serves a batch, several lanes side by side. Numbers are arguments, so that nothing is known
while the kernel is written; a third kernel has them as constants, which takes the rules' other
branch."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from equinox import internal as eqxi
from equinox.internal._loop.common import maybe_set_p, select_if_vmap_p
from jax import lax
from jax.extend.core import jaxprs_in_params
from jax.extend.core.primitives import closed_call_p

import jaxclear  # noqa: F401  (float64)
from jaxclear.ground.elimination import Pattern, solved
from jaxclear.ground.grouping import in_memory, looked_up
from jaxclear.ground.grouping import summed as summed_by_place
from jaxclear.native import explain, verdict, while_loop
from jaxclear.native.verdicts import KERNELS
from jaxclear.native.while_loops import as_kernel
from jaxclear.native.writer import RULES
from tests.rigs.cells import slow

# Functions of the C library and XLA's own series differ by a few units in the last place.
ROUNDING = 1e-13
LANES = 5
# Where the slope of erf is small.
FAR = np.array([1e-9, 0.3, 3.3, -5.1, 9.87654321, -17.3, 26.1, 40.0])
INF, NAN = np.inf, np.nan
# JAX writes these itself since then: squares from 1 in derivatives, calls of programs at hand.
NEWEST = jax.__version_info__ >= (0, 12)
X = np.array([0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 3.5, 1e-300, -7e5, INF, -INF, NAN])
# All pairs of six of them: an array of more than 64 numbers would stay in memory.
FIRST, SECOND = (part.ravel() for part in np.meshgrid(*[X[[0, 1, 3, 5, 9, 11]]] * 2))
BOUNDED = np.array([0.0, -0.0, 1.0, -1.0, 0.5, -0.25, 1e-9, 2.0, NAN])
SMALL = np.array([[0.5, -1.0, 2.0], [0.0, -0.0, 3.0]])
WITH_NAN = np.array([[0.5, NAN, 2.0], [-INF, -0.0, INF]])
N = np.array([0, 1, -1, 7, -8, 3, 100])
M = np.array([2, -3, 0, 4, -1, -5, 0])
T, U = np.array([True, True, False, False]), np.array([True, False, True, False])
PLACES = np.arange(160) * 7 % 80
TABLE = np.linspace(-1.0, 1.0, 90).reshape(30, 3)  # more than 64 numbers: stays in memory


def unary(name, *more):
    return [(getattr(lax, name), (values,)) for values in (X, *more)]


def binary(name, *more):
    return [(getattr(lax, name), pair) for pair in ((FIRST, SECOND), *more)]


def jitted(function):
    return jax.jit(lambda x: function(x) + 1.0)


@jax.custom_jvp
def own_jvp(x):
    return 2.0 * x


@jax.custom_vjp
def own_vjp(x):
    return 3.0 * x


own_jvp.defjvp(lambda x, t: (own_jvp(*x), 2.0 * t[0]))
own_vjp.defvjp(lambda x: (3.0 * x, None), lambda _, t: (3.0 * t,))


def slope_of_erf(x):
    return jax.jvp(lax.erf, (x,), (jnp.ones_like(x),))[1]


def half_of_the_digits(x, kind):
    """A float cut by its bits, as JAX does it; the largest numbers without a sign are beyond those
    with one."""
    mask = np.array(-(2**27), np.int64).view(kind)
    bits = lax.bitcast_convert_type(jnp.asarray(x, float), kind)
    return lax.bitcast_convert_type(bits & mask, float)


def called_by_name(x):
    """The call that newer versions of JAX write for a program at hand, by its primitive."""
    program = jax.make_jaxpr(lambda y: 3.0 * y)(x)
    return closed_call_p.bind(x, call_jaxpr=program)[0] if NEWEST else 3.0 * x


def polynomial(x, *factors):
    if NEWEST:
        return lax.polynomial(x, factors)
    return functools.reduce(lambda sum, factor: sum * x + factor, reversed(factors))


def set_at(allowed, array, value, i):
    treedef = jax.tree.structure(0)
    given = {"i_static": None, "i_treedef": treedef, "kwargs": (), "makes_false_steps": False}
    return maybe_set_p.bind(allowed, array, value, i, **given)[0]


def scan(x, rows):
    last, seen = lax.scan(lambda c, r: (0.5 * c + r, c - r), x, rows)
    return last, seen, lax.scan(lambda c, r: (0.5 * c + r, c), x, rows, reverse=True)[1]


def summed(x, rows):
    """More turns than are written out, whose rows are few numbers."""
    return lax.scan(lambda c, r: (0.5 * c + r, None), x, rows)[0]


def unstacked(x, axis):
    """jax.numpy has no name for it: the derivative of a stack."""
    parts = jnp.moveaxis(jnp.zeros_like(x), axis, 0)
    return jax.vjp(lambda *p: jnp.stack(p, axis), *parts)[1](x)


def system(x):
    """Diagonally dominant, for any numbers of these."""
    pattern = Pattern(3, ((0, 0), (1, 0), (1, 1), (2, 1), (2, 2)))
    return solved(pattern, jnp.stack([3.0, x[0], 4.0, x[1], 5.0]), None, x[1:])


def count(x):
    return lax.while_loop(lambda s: s[0] < x[0], lambda s: (s[0] + 1.0, 1.5 * s[1]), (0.0, x))


def native_count(x):
    """As `count`, by the loops of this room: the one of one turn, and around it the other."""
    turn = lambda s: (s[0] + 1.0, as_kernel(lambda y: 1.5 * y, s[1]))
    return while_loop(lambda s: s[0] < x[0], turn, (jnp.zeros(()), x))


# For each primitive: functions, each with the arrays it is tried on.
CASES = {
    **{name: binary(name, (N, M)) for name in ("add", "sub", "mul", "div", "rem", "max", "min")},
    **{name: binary(name, (N, M)) for name in ("eq", "ne", "lt", "le", "gt", "ge")},
    "add_any": [(lambda x, y: jax.vjp(lambda a: (a * y, a + y), x)[1]((y, x))[0], (X, X[::-1]))],
    **{name: binary(name) for name in ("pow", "nextafter")},
    # Both infinite is no direction: the kernel's angle is then nan.
    "atan2": [(lax.atan2, (FIRST, np.where(np.isinf(SECOND), 2.0, SECOND)))],
    **{name: unary(name, N) for name in ("neg", "abs", "sign", "square")},
    **{name: unary(name) for name in ("sqrt", "rsqrt", "cbrt", "exp", "exp2", "expm1")},
    **{name: unary(name) for name in ("log", "log1p", "sin", "cos", "tan", "atan", "tanh")},
    **{name: unary(name) for name in ("sinh", "cosh", "asinh", "acosh", "erf", "is_finite")},
    **{name: [(getattr(lax, name), (BOUNDED,))] for name in ("asin", "acos", "atanh")},
    **{name: unary(name) for name in ("floor", "ceil")},
    "round": [
        (functools.partial(lax.round, rounding_method=how), (X,)) for how in lax.RoundingMethod
    ],
    "integer_pow": [(functools.partial(lax.integer_pow, y=y), (X,)) for y in (-3, -1, 2, 3, 7)],
    "clamp": [(lax.clamp, (np.full(12, -0.5), X, np.full(12, 3.0))), (lax.clamp, (N - 1, N, M))],
    **{name: binary(name, (T, U), (N, M))[1:] for name in ("bitwise_and", "bitwise_or")},
    "bitwise_xor": binary("bitwise_xor", (T, U), (N, M))[1:],
    "not": [(lax.bitwise_not, (T,))],
    "select_n": [(lax.select_n, (X > 0, X, X[::-1])), (lax.select_n, (T, N[:4], M[:4]))],
    # What a float that is not finite becomes as a whole number is undefined.
    "convert_element_type": [
        (lambda x, kind=kind: lax.convert_element_type(x, kind), (values,))
        for values in (X[:9], N, T)
        for kind in (float, int, bool)
        if kind != values.dtype
    ],
    "copy": [(jnp.copy, (X,))],
    "optimization_barrier": [(lax.optimization_barrier, (X,))],
    "reduce_precision": [(lambda x: lax.reduce_precision(x, 11, 52), (X,))],
    "broadcast_in_dim": [(lambda x: lax.broadcast_in_dim(x, (2, 2, 3), (0, 2)), (SMALL,))],
    "reshape": [(lambda x: x.reshape(3, 2), (SMALL,)), (lambda t: t.reshape(90)[17], (TABLE,))],
    "squeeze": [
        (lambda x: lax.squeeze(x, (1,)), (SMALL[:, None],)),
        (lambda t: lax.squeeze(t, (0,))[4], (TABLE[None],)),
    ],
    "transpose": [(jnp.transpose, (SMALL,)), (lambda t: jnp.transpose(t)[1], (TABLE,))],
    "rev": [(lambda x: lax.rev(x, (0, 1)), (SMALL,))],
    "slice": [(lambda x: x[:, 0:3:2], (SMALL,)), (lambda t: t[3:9:2, 1:], (TABLE,))],
    "concatenate": [(lambda x: lax.concatenate([x, x], 1), (SMALL,))],
    "pad": [
        (lambda x, config=config: lax.pad(x, 7.0, config), (SMALL,))
        for config in (((1, 2, 0), (0, 1, 2)), ((0, 0, 1), (-1, -1, 0)), ((-1, 0, 0), (2, -3, 1)))
    ],
    "stack": [(lambda x: jnp.stack([x, 2 * x], 1), (SMALL,))],
    "unstack": [
        (functools.partial(unstacked, axis=axis), (values,))
        for values, axis in ((SMALL, 0), (SMALL, 1), (SMALL[0], 0))
    ],
    "split": [(lambda x: tuple(lax.split(x, (1, 2), 1)), (SMALL,))],
    "iota": [(lambda x: lax.broadcasted_iota(d, (2, 3), 1) + x, (1,)) for d in (float, int)],
    **{
        f"reduce_{name}": [
            (lambda x, f=function, axis=axis: f(x, axis), (values,))
            for values in (SMALL, WITH_NAN, N.reshape(1, 7), SMALL[:0])
            for axis in (0, 1, (0, 1))
        ]
        for name, function in {"sum": jnp.sum, "prod": jnp.prod}.items()
    },
    **{
        f"reduce_{name}": [
            (lambda x, f=function, axis=axis: f(x, axis), (values,))
            for values in (SMALL, WITH_NAN, N.reshape(1, 7))
            for axis in (0, 1, (0, 1))
        ]
        for name, function in {"max": jnp.max, "min": jnp.min}.items()
    },
    **{
        f"reduce_{name}": [(f, (T,)), (f, (U[:1],)), (f, (T[:0],)), (f, (T[2:],))]
        for name, f in {"and": jnp.all, "or": jnp.any}.items()
    },
    "dot_general": [
        (lambda a, b: a @ b.T, (SMALL, SMALL[::-1])),
        (lambda a, b: jnp.einsum("bi,bij->bj", a, b), (SMALL, np.stack([SMALL.T @ SMALL] * 2))),
    ],
    "dynamic_slice": [
        (lambda x, i: lax.dynamic_slice(x, (i, i), (1, 2)), (array, i))
        for array in (SMALL, TABLE)
        for i in (-2, 0, 1, 50)
    ],
    "dynamic_update_slice": [
        (lambda x, y, i: lax.dynamic_update_slice(x, y, (i, 0)), (SMALL, SMALL[:1], i))
        for i in (-2, 0, 1, 50)
    ],
    "gather": [
        (lambda x, i: x.at[i].get(mode="promise_in_bounds"), (array, np.array([0, 1, 1])))
        for array in (SMALL, TABLE)
    ],
    "scatter": [(lambda x, y, i: x.at[i, 1].set(y), (SMALL, 9.0, i)) for i in (0, 1)],
    "scatter-add": [(lambda x, y: x.at[1, 2].add(y), (SMALL, 9.0))],
    "log2": [(getattr(lax, "log2", jnp.log2), (X,))],
    "one_minus_square": [
        (getattr(lax, "one_minus_square", lambda x: (1 + x) * (1 - x)), (values,))
        for values in (X, 1.0 + 1e-9 * X[:6], N)
    ],
    "polynomial": [(polynomial, (X[:9], 2.0, -1.0, X[:9])), (polynomial, (0.3, 1.0, X, 4.0))],
    "eval_jaxpr": [(called_by_name, (SMALL,))],
    "jit": [(jitted(jnp.sin), (SMALL,))],
    "remat2": [(jax.checkpoint(lambda x: 2.0 * x), (SMALL,))],
    "custom_jvp_call": [
        (own_jvp, (SMALL,)),
        *((slope_of_erf, (values,)) for values in (X, FAR) if NEWEST),
    ],
    "bitcast_convert_type": [
        (functools.partial(half_of_the_digits, kind=kind), (values,))
        for kind in (np.uint64, np.int64)
        for values in (X, FAR, 0.7)
    ],
    "custom_vjp_call": [(own_vjp, (SMALL,))],
    "cond": [(lambda p, x: lax.cond(p, jnp.sin, jnp.cos, x), (p, SMALL)) for p in (True, False)],
    "scan": [(scan, (SMALL[0], SMALL)), (summed, (SMALL[0], np.resize(SMALL, (20, 3))))],
    "while": [(count, (np.array([n, 1.0]),)) for n in (-1.0, 0.0, 4.0, NAN)],
    "jaxclear_loop": [(native_count, (np.array([n, 1.0]),)) for n in (-1.0, 0.0, 4.0, NAN)],
    # An error that is not raised: where it would be, the program ends.
    "pure_callback": [(lambda x, p: eqx.error_if(x, p, "never"), (SMALL, np.array(False)))],
    "unvmap_any": [(eqxi.unvmap_any, (np.array(True),))],
    "unvmap_all": [(eqxi.unvmap_all, (np.array(False),))],
    "nonbatchable": [(eqxi.nonbatchable, (SMALL,))],
    "select_if_vmap": [
        (
            lambda p, x: select_if_vmap_p.bind(p, x, 2 * x),
            (np.array(True), np.array(3.0)),
        )
    ],
    "jaxclear_symmetric_solve": [(system, (np.array([0.3, -0.2, 0.7, 0.1]),))],
    "jaxclear_in_memory": [
        (lambda x: looked_up(in_memory(2.0 * x), PLACES), (np.resize(SMALL, 80),)),
        (lambda x: summed_by_place(in_memory(x), PLACES[:80] % 7, 7), (np.resize(SMALL, 80),)),
        (in_memory, (SMALL,)),
    ],
    "maybe_set": [(set_at, (np.array(True), SMALL, SMALL[0], i)) for i in (0, 1)],
}
for name in ("and", "or", "xor"):
    CASES[name] = CASES.pop(f"bitwise_{name}")
# Names that this version of JAX does not write, or only in other places, of the same rules.
OTHER_NAMES = {
    **dict.fromkeys(("pjit", "closed_call", "core_call", "remat", "checkpoint"), "jit"),
    **dict.fromkeys(("copy_p", "stop_gradient"), "copy"),
    "expand_dims": "reshape",
}
# Primitives that some allowed version of JAX does not know yet.
SINCE = {
    **dict.fromkeys(("stack", "unstack"), (0, 10, 2)),
    **dict.fromkeys(("eval_jaxpr", "log2", "one_minus_square", "polynomial"), (0, 12)),
}


def inner_programs(jaxpr):
    yield jaxpr
    for equation in jaxpr.eqns:
        for inner in jaxprs_in_params(equation.params):
            yield from inner_programs(inner)


def flat(function, arrays):
    """The outputs of a case as one list."""
    return jax.tree.leaves(function(*arrays))


def every_case(inputs):
    """The outputs of the cases of some primitives, by name, for their inputs."""
    return {
        name: [
            flat(function, given) for (function, _), given in zip(CASES[name], arrays, strict=True)
        ]
        for name, arrays in inputs.items()
    }


def by_a_kernel(inputs):
    """As `every_case`, in one turn of a loop; and what became of the loop."""
    first = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(every_case, inputs))
    turn = lambda state: (state[0] + 1, every_case(inputs))
    found = while_loop(lambda state: state[0] < 1, turn, (0, first))
    return found[1], verdict(found[0])


# A kernel of them all takes LLVM minutes, of so many seconds.
TOGETHER = 12
GROUPS = [sorted(CASES)[i : i + TOGETHER] for i in range(0, len(CASES), TOGETHER)]


def rolled(names, turn):
    """The inputs of some cases; other numbers of the same shapes for a further sample of a
    batch."""
    roll = lambda x: np.roll(x, turn) if np.ndim(x) else np.asarray(x)
    return {name: [jax.tree.map(roll, given) for _, given in CASES[name]] for name in names}


@functools.cache
def wanted(group, turn):
    return jax.device_get(jax.jit(every_case)(rolled(GROUPS[group], turn)))


@functools.cache
def found(group, how):
    """Their outputs, a list of samples: of one sample, of a batch, of numbers known while
    writing."""
    inputs = [rolled(GROUPS[group], turn) for turn in range(LANES)]
    if how == "batch":
        values, told = jax.jit(jax.vmap(by_a_kernel))(jax.tree.map(lambda *x: np.stack(x), *inputs))
        values = [jax.tree.map(lambda x, i=i: x[i], jax.device_get(values)) for i in range(LANES)]
    else:
        known = jax.jit(lambda: by_a_kernel(jax.tree.map(jnp.asarray, inputs[0])))
        values, told = known() if how == "known" else jax.jit(by_a_kernel)(inputs[0])
        values = [values]
    assert explain(jnp.max(told)) == KERNELS
    return jax.device_get(values)


@pytest.mark.parametrize("name", sorted(CASES))
@pytest.mark.parametrize("how", ["alone", "batch", *slow("known")])
def test_rule_gives_what_jax_gives(name, how):
    group = next(i for i, names in enumerate(GROUPS) if name in names)
    for turn, values in enumerate(found(group, how)):
        for mine, theirs in zip(values[name], wanted(group, turn)[name], strict=True):
            for one, other in zip(mine, theirs, strict=True):
                assert (one.shape, one.dtype) == (other.shape, other.dtype)
                np.testing.assert_allclose(one, other, rtol=ROUNDING, atol=0)


@pytest.mark.parametrize("name", sorted(RULES))
def test_every_rule_has_a_case(name):
    if name in OTHER_NAMES:
        other = OTHER_NAMES[name]
        assert name == "expand_dims" or RULES[name] is RULES[other]
        assert other in CASES
        return
    for function, arrays in CASES[name]:
        jaxpr = jax.make_jaxpr(function)(*arrays).jaxpr
        names = {e.primitive.name for inner in inner_programs(jaxpr) for e in inner.eqns}
        assert name in names or jax.__version_info__ < SINCE.get(name, ())


def slope(function, arrays):
    """The program of a case's derivative along its own floats, if there is one."""
    moving = [i for i, a in enumerate(arrays) if np.issubdtype(np.result_type(a), np.floating)]

    def along(*some):
        given = dict(zip(moving, some, strict=True))
        return function(*[given.get(i, jnp.asarray(a)) for i, a in enumerate(arrays)])

    floats = [jnp.asarray(arrays[i]) for i in moving]
    try:
        return jax.make_jaxpr(lambda *x: jax.jvp(along, x, x))(*floats).jaxpr
    except NotImplementedError:  # nextafter has none
        return None


# Reverse mode alone; and bits, which have none.
NO_SLOPE = {"custom_vjp_call", "bitcast_convert_type"}


@pytest.mark.parametrize("name", sorted(CASES.keys() - NO_SLOPE))
def test_what_jax_writes_for_a_slope_has_rules(name):
    """Which primitives these are changes from one version of JAX to the next."""
    for function, arrays in CASES[name]:
        if (jaxpr := slope(function, arrays)) is not None:
            names = {e.primitive.name for inner in inner_programs(jaxpr) for e in inner.eqns}
            assert names <= RULES.keys()
