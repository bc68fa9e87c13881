"""A while loop as two programs, how its numbers reach a kernel, and how a program is gone through
equation by equation.

A kernel takes one packed row of floats for each sample (constants, then the first state; whole
numbers and truth values as floats, which is exact to 2^53), and long arrays of constants, which it
reads by index; it gives one packed row, the last state, those long arrays of the state that it
changes in memory, and of a loop of known length a table of each array that a turn leaves.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal
from jax.interpreters import ad

from jaxclear.native.writer import LONGEST_IN_REGISTERS

# What calls a program.
CALLS = (
    "jit",
    "pjit",
    "closed_call",
    "core_call",
    "eval_jaxpr",
    "remat",
    "checkpoint",
    "remat2",
    "custom_jvp_call",
    "custom_vjp_call",
)


def called_program(parameters: dict) -> Any:
    """The program that one of the `CALLS` calls."""
    return next(parameters[k] for k in ("jaxpr", "call_jaxpr", "fun_jaxpr") if k in parameters)


class Table(NamedTuple):
    """Where one of the arrays that a turn leaves is kept: in `height` rows, that of a turn at the
    place that an array of numbers says, which is the body's constant number `places` (beyond the
    table: nowhere); the constant number `start` stands in the first row from the start (None:
    nothing does). Every row is somebody's."""

    height: int
    places: int
    start: int | None = None


class Program(NamedTuple):
    """A while loop as two programs: condition over (its constants, state), body over (its
    constants, state). `single_turn`: it always takes one turn, and so is a function; `vmapped`: one
    that is left to XLA as if it had never been here where it is no kernel. `tangents`: inputs of
    the body that nothing but other tangents depends on; `motion`: the loop without the last of
    them. `length`: of a loop that takes so many turns, which the state's first number counts, and
    whose body gives a row of results behind the state, kept in as many `tables` (0: of any other).
    `within`: it stands in the body of another loop, whose kernel it is a part of. `narrow`: the
    loop of one of the tangents that it takes side by side. `shared`: constants that are the same
    for all samples of a batch, and have no axes for them. `long`: parts of the state that stand in
    memory, and are changed there. `resumed`: it stands in a turn that takes it up again where some
    samples were left unfinished, so it may end when half of those that the turn goes through have.
    """

    condition: ClosedJaxpr
    body: ClosedJaxpr
    condition_constants: int
    body_constants: int
    single_turn: bool = False
    tangents: frozenset[int] = frozenset()
    motion: "Program | None" = None
    length: int = 0
    within: bool = False
    narrow: "Narrow | None" = None
    tables: tuple[Table, ...] = ()
    shared: frozenset[int] = frozenset()
    long: frozenset[int] = frozenset()
    vmapped: bool = False
    resumed: bool = False


class Narrow(NamedTuple):
    """A loop of which so many `tangents` are wanted: which of its inputs differ
    between these (`batched`) and which parts of its last state and of a row do (`moving`)."""

    program: Program
    batched: tuple[bool, ...]
    moving: tuple[bool, ...]
    tangents: int


def scan_counts(params: dict[str, Any]) -> tuple[int, int]:
    """Constants and carried values of a scan, which JAX counts from 0.12 on by the trees of its
    arguments."""
    if "num_consts" in params:
        return params["num_consts"], params["num_carry"]
    argument_tree = range(len(params["jaxpr"].in_avals))
    constants, carried, _ = params["ft_in"].update(argument_tree).unpack()
    return len(list(constants)), len(list(carried))


def avals_of(program: Program) -> tuple[list, list]:
    """Shapes and types of (constants of both programs in turn, state)."""
    first, second = program.condition.in_avals[: program.condition_constants], program.body.in_avals
    return [*first, *second[: program.body_constants]], list(second[program.body_constants :])


def in_memory(program: Program) -> list[bool]:
    """For each constant and then each part of the state, whether it stays in memory instead of
    being packed.
    """
    constants, state = avals_of(program)
    long = [
        int(np.prod(a.shape)) > LONGEST_IN_REGISTERS and a.dtype == np.float64 for a in constants
    ]
    return [*long, *(i in program.long for i in range(len(state)))]


def arrays_in_memory(program: Program) -> list:
    """Shapes and types of the parts of the state that stand in memory."""
    state = avals_of(program)[1]
    return [state[i] for i in sorted(program.long)]


def packed_state(program: Program) -> list:
    """Those of the others, which are packed."""
    return [a for i, a in enumerate(avals_of(program)[1]) if i not in program.long]


def row_of(program: Program) -> list:
    """Shapes and types of the row that every turn leaves."""
    return list(program.body.out_avals[len(avals_of(program)[1]) :])


def floats_in(avals: Sequence) -> int:
    """Numbers in arrays of these shapes."""
    return sum(int(np.prod(a.shape)) for a in avals)


def packed(values: Sequence[Any]) -> np.ndarray:
    """Arrays as one row of floats."""
    return np.concatenate([np.ravel(v).astype(float) for v in values])


def loops_marked(program: Any, within: bool) -> Any:
    """A program whose loops of this room are marked as standing `within` another loop, or not."""
    # From JAX 0.11 on the two are one class.
    if isinstance(program, ClosedJaxpr) and ClosedJaxpr is not Jaxpr:
        return ClosedJaxpr(loops_marked(program.jaxpr, within), program.consts)

    def marked(value):
        if isinstance(value, (Jaxpr, ClosedJaxpr)):
            return loops_marked(value, within)
        if isinstance(value, Program):
            return value._replace(within=within)
        # The branches of a choice.
        return tuple(map(marked, value)) if type(value) is tuple else value

    equations = [
        equation.replace(params={name: marked(value) for name, value in equation.params.items()})
        for equation in program.eqns
    ]
    return program.replace(eqns=equations)


def batches_loops(program: Any) -> bool:
    """Whether loops of this room within a program are batches, which no kernel goes through."""
    if isinstance(program, Program):
        return batches_loops(program.body)
    if type(program) is tuple:
        return any(map(batches_loops, program))
    if not isinstance(program, (Jaxpr, ClosedJaxpr)):
        return False
    return any(
        any(map(batches_loops, equation.params.values()))
        or (
            equation.primitive.name == "jaxclear_loop"
            # Functions of few rows are written out for one after the other.
            and equation.params["rank"] > equation.params["program"].single_turn
        )
        for equation in getattr(program, "jaxpr", program).eqns
    )


def size_of(program: Any) -> int:
    """Equations of a program, those of programs within it included."""
    total = 0
    for equation in getattr(program, "jaxpr", program).eqns:
        inner = [v for v in equation.params.values() if isinstance(v, (Jaxpr, ClosedJaxpr))]
        total += sum(map(size_of, inner)) if inner else 1
    return total


def numbers_in(program: Any) -> int:
    """Numbers that the equations of a program go through, each the largest of its arrays."""
    total = 0
    for equation in getattr(program, "jaxpr", program).eqns:
        inner = [v for v in equation.params.values() if isinstance(v, (Jaxpr, ClosedJaxpr))]
        sizes = (v.aval.size for v in (*equation.invars, *equation.outvars))
        total += sum(map(numbers_in, inner)) if inner else max(sizes, default=0)
    return total


def evaluate_constants(program: ClosedJaxpr, arguments: Sequence[Any]) -> dict[Any, Any]:
    """Values of a program's variables as it begins."""
    jaxpr = program.jaxpr
    names = [*jaxpr.constvars, *jaxpr.invars]
    return dict(zip(names, [*program.consts, *arguments], strict=True))


def read(atoms: Sequence[Any], values: dict[Any, Any]) -> list:
    """What variables and numbers of a program stand for."""
    number = lambda literal: jnp.asarray(literal.val, literal.aval.dtype)
    return [number(atom) if isinstance(atom, Literal) else values[atom] for atom in atoms]


def apply(equation: Any, inputs: Sequence[Any], parameters: dict[str, Any]) -> Sequence[Any]:
    """Results of an equation's operation, as a list.

    Args:
        equation: of a JAX program.
        inputs: values of its operands.
        parameters: in the place of those of the equation.
    """
    results = equation.primitive.bind(*inputs, **parameters)
    return results if equation.primitive.multiple_results else [results]


def replay(
    program: ClosedJaxpr,
    arguments: Sequence[Any],
    one: Callable[[Any, list], Sequence[Any]] = lambda e, inputs: apply(e, inputs, e.params),
) -> list:
    """Results of a program, evaluated equation by equation, with called functions inlined.

    Args:
        program: closed JAX program.
        arguments: its inputs.
        one: function from an equation and its inputs to its results; default: applies the equation.
    """
    values = evaluate_constants(program, arguments)
    for equation in program.jaxpr.eqns:
        inputs = read(equation.invars, values)
        if equation.primitive.name in CALLS:
            inner = called_program(equation.params)
            inner = inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, [])
            inner_results: Sequence[Any] = replay(inner, inputs, one)
        else:
            inner_results = one(equation, inputs)
        values |= dict(zip(equation.outvars, inner_results, strict=True))
    return read(program.jaxpr.outvars, values)


def traced(function: Callable, avals: Sequence[Any]) -> ClosedJaxpr:
    """The program of a function over arrays of these shapes and types."""
    return jax.make_jaxpr(function)(*(jax.ShapeDtypeStruct(a.shape, a.dtype) for a in avals))


def constants_first(program: ClosedJaxpr) -> ClosedJaxpr:
    """The program, its constants as leading arguments."""
    jaxpr = program.jaxpr
    invars = [*jaxpr.constvars, *jaxpr.invars]
    return ClosedJaxpr(jaxpr.replace(constvars=[], invars=invars), [])


def fix_arguments(function: Callable, values: Sequence[Any], moving: Sequence[int]) -> Callable:
    """The function with some of its arguments fixed.

    Args:
        function: of all arguments.
        values: all arguments; the moving ones are replaced.
        moving: positions of the arguments that remain.
    """

    def of_some(*some):
        all_values = list(values)
        for place, value in zip(moving, some, strict=True):
            all_values[place] = value
        return function(*all_values)

    return of_some


def still(value: Any) -> ad.Zero:
    """The tangent of what does not move."""
    return ad.Zero(jax.core.ShapedArray(value.shape, value.dtype).to_tangent_aval())


def samples_in(values: Sequence[Any], dims: Sequence[int | None]) -> int:
    """How many samples `jax.vmap` maps over, along these axes."""
    return next(np.shape(v)[d] for v, d in zip(values, dims, strict=True) if d is not None)


def heard(weight: Any, cotangent: Any) -> Any:
    """Their product, where what is not asked for may have overflowed: inf * 0 is 0 here. A finite
    one stays, for its product has a slope where what is asked passes through 0."""
    return jnp.where((cotangent == 0) & ~jnp.isfinite(weight), 0.0, weight) * cotangent
