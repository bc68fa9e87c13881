"""Fields that know their unit and meaning, so that a mechanism can print its own table of
parameters.

A quantity is a float64 leaf of a pytree: it can be varied, differentiated and batched. `None` means
absent and leaves no operation in the compiled program. A vector quantity is a tuple of scalar
leaves, because each component can then be varied by itself and a component that is not given is
known to be zero before tracing.

Every class with quantities derives from `AbstractQuantified`, which checks their ranges when an
object is built from numbers; a number that is being traced was checked before, or is a sample's.

What a field of a class may hold, read from its declaration once a class: a number, several, a
part of a family, a name, a count, a flag, a function.

A field says it by its type (`AbstractWearLaw | None`, `int`, `str`, `Callable`) and its metadata
(`unit`, `counts`, `at_least`). What this module does not know (`Any`, arrays) is left to the class.
"""

import copy
import dataclasses
import functools
import math
import types
from collections.abc import Callable, Iterator, Mapping
from types import GenericAlias, NoneType, UnionType
from typing import (
    TYPE_CHECKING,
    Any,
    NamedTuple,
    ParamSpec,
    TypeAlias,
    TypeVar,
    Union,
    get_args,
    get_origin,
)

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import get_opaque_trace_state
from jaxtyping import Array, Float

from jaxclear.ground.argument_errors import AnsweringMeta
from jaxclear.ground.precision import check_double_precision, check_not_forked
from jaxclear.ground.printing import AbstractShown, part_in_words, specify_unit
from jaxclear.ground.wording import described, final_members, offered_like, public_name

# Things that a function of Python's encloses, of which no more are looked at.
MOST_ENCLOSED = 1000
SIMPLE: dict[Any, tuple[tuple[type, ...], str]] = {
    str: ((str,), "a name or word (text)"),
    bool: ((bool, np.bool_), "True or False"),
    int: ((int, np.integer), "a whole number"),
}


class FieldRule(NamedTuple):
    """What one field may hold: `name`; `allowed` types as they are; whether a `number` (with a
    unit), or so many of them (`counts`; () for any number); `entries` type of a tuple's entries and
    `length` of it; `wanted` in words."""

    name: str
    allowed: tuple[type, ...]
    number: bool
    counts: tuple[int, ...] | None
    function: bool
    simple: tuple[type, ...]
    entries: type | None
    length: int | None
    least: float | None
    allowed_text: str

    def admits(self, value: Any) -> bool:
        """Whether the field may hold this value; ranges of numbers apart."""
        if isinstance(value, self.allowed) or (self.number and _is_quantity(value)):
            return True
        if self.counts is not None and isinstance(value, tuple):
            fits = all(_is_quantity(x) for x in value)
            return fits and (len(value) in self.counts if self.counts else len(value) > 0)
        if self.entries is not None and isinstance(value, tuple):
            fits = all(_is_simple(x, SIMPLE[self.entries][0]) for x in value)
            return fits and self.length in (None, len(value))
        if self.function and callable(value) and not isinstance(value, type):
            return True
        if not _is_simple(value, self.simple):
            return False
        return self.least is None or value >= self.least


def _is_quantity(value: Any) -> bool:
    """Whether something is a quantity, or what `with_quantities` makes one of, once equinox.tree_at
    has put it there."""
    if isinstance(value, jax.Array):
        return value.ndim == 0 and value.dtype == FLOAT64
    try:
        return is_one_number(value) and as_number(value) is not None
    except ValueError:
        return False


def _is_simple(value: Any, kinds: tuple[type, ...]) -> bool:
    """A flag counts as a number in Python, but not here."""
    flag = isinstance(value, (bool, np.bool_))
    return bool(kinds) and isinstance(value, kinds) and (bool in kinds or not flag)


@functools.cache
def field_rules(kind: type) -> tuple[FieldRule, ...]:
    """The rules of a class's fields, of those that this module knows."""
    rules = (_rule(field) for field in dataclasses.fields(kind))
    return tuple(rule for rule in rules if rule is not None)


def _rule(field: dataclasses.Field) -> FieldRule | None:
    kinds = tuple(members_of_union(field.type))
    measured = "unit" in field.metadata
    counts = field.metadata.get("counts", ())
    several = measured and (tuple in kinds or "counts" in field.metadata)
    functions = {k for k in kinds if k is Callable or get_origin(k) is Callable}
    either = tuple in kinds and bool({*kinds} - {tuple, NoneType} - functions)
    allowed = [k for k in kinds if isinstance(k, type) and issubclass(k, eqx.Module)]
    optional = NoneType in kinds or (field.default is None)
    simple = tuple(one for k in kinds if k in SIMPLE for one in SIMPLE[k][0])
    function = bool(functions)
    tuples = [k for k in kinds if isinstance(k, GenericAlias) and get_origin(k) is tuple]
    entries, length = None, None
    if tuples and get_args(tuples[0])[0] in SIMPLE:
        inner = get_args(tuples[0])
        entries, length = inner[0], None if Ellipsis in inner else len(inner)
    has_rule = measured or allowed or simple or function or entries
    strange = any(k is Any or isinstance(k, str) for k in kinds) and not measured
    if not has_rule or strange or not field.init:
        return None
    return FieldRule(
        field.name,
        (*allowed, *([NoneType] if optional else [])),
        measured and (either or not several),
        counts if several else None,
        function,
        simple,
        entries,
        length,
        field.metadata.get("at_least") if simple else None,
        _allowed_text(field, allowed, several, function, (entries, length), optional),
    )


def members_of_union(declared: Any) -> Iterator[Any]:
    """The members of a union, or the type itself."""
    if isinstance(declared, UnionType) or get_origin(declared) is Union:
        for part in get_args(declared):
            yield from members_of_union(part)
    else:
        yield declared


def _allowed_text(field, allowed, several, function, of_tuple, optional) -> str:
    """What the field may hold, in words."""
    entries, length = of_tuple
    if "wanted" in field.metadata:
        words = [field.metadata["wanted"]]
    elif several:
        counts = field.metadata.get("counts", ())
        number = " or ".join(map(str, counts)) if counts else "several"
        words = [f"{number} numbers{_unit(field)}"]
    elif "unit" in field.metadata:
        words = [f"one number{_unit(field)}"]
        words += [_class_or_family_path(kind) for kind in allowed]
    elif entries is not None:
        what = SIMPLE[entries][1].removeprefix("a ").removesuffix(" (text)")
        words = [f"{length or 'some'} {what}s in a tuple"]
    else:
        words = [_class_or_family_path(kind) for kind in allowed]
        words += [SIMPLE[kind][1] for kind in members_of_union(field.type) if kind in SIMPLE]
        limits = range_in_words(field.metadata)
        words[-1:] = [f"{words[-1]}, {limits}"] if limits and words else words[-1:]
    words += ["a function of time"] if function and "unit" in field.metadata else []
    words += ["a function"] if function and "unit" not in field.metadata else []
    return " or ".join([*words, *(["None"] if optional else [])])


def _unit(field: dataclasses.Field) -> str:
    unit = field.metadata["unit"]
    return "" if unit == "1" or unit.startswith("(") else f" [{unit}]"


def _class_or_family_path(kind: type) -> str:
    """A class, or for a family the place where its members are."""
    path = public_name(kind)
    place, _, name = path.rpartition(".")
    if not kind.__module__.startswith("jaxclear"):
        return f"one of {kind.__module__.partition('.')[0]}"
    if not kind.__name__.startswith("Abstract"):
        return f"a jaxclear.{path}"
    places = dict.fromkeys(public_name(member).rpartition(".")[0] for member in final_members(kind))
    modules = [place] if place in places or not any(places) else [each for each in places if each]
    if not any(modules):
        return f"a {name.removeprefix('Abstract')}"
    return f"one of {' or '.join(f'jaxclear.{each}' for each in modules)}"


def range_in_words(metadata: Any) -> str:
    """The range of a field: "above 0 and at most 1"."""
    words = {"above": "above", "at_least": "at least", "below": "below", "at_most": "at most"}
    return " and ".join(
        f"{word} {metadata[key]:g}" for key, word in words.items() if key in metadata
    )


def check_kinds(owner: Callable[[], str], part: Any) -> None:
    """Raises `ValueError` where a field holds what it may not; `owner` says whose field it is."""
    for rule in field_rules(type(part)):  # type: ignore[arg-type]
        value = getattr(part, rule.name)
        if not rule.admits(value):
            raise ValueError(
                f"{owner()} has {rule.name} = {described(value)}; it must be {rule.allowed_text}"
                f"{_hint_to_build(rule, value)}."
            )


def _hint_to_build(rule: FieldRule, value: Any) -> str:
    """For what has only not been built, how to build it."""
    if isinstance(value, type) and issubclass(value, rule.allowed):
        return f": build one, {value.__name__}(...)"
    if isinstance(value, str) and not rule.simple:
        for kind in rule.allowed:
            path = public_name(kind)
            close = offered_like(value, path) if "." in path else ""
            if close:
                return f", such as {close}(...)"
    fields = dataclasses.fields(value) if isinstance(value, eqx.Module) else ()
    for inner in (getattr(value, field.name) for field in fields):
        if isinstance(inner, rule.allowed):
            return f": what it holds is one, {public_name(type(inner))}(...)"
    if rule.allowed and not rule.function and callable(value) and value.__class__ is type(_rule):
        return f": call it, {value.__name__}(...)"
    return ""


def lenient_converter(converter: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """The converter of a field, which leaves alone what it cannot convert: the field's check then
    refuses it by name."""

    @functools.wraps(converter)
    def convert(value: Any) -> Any:
        try:
            return converter(value)
        except (ValueError, TypeError, OverflowError):
            return value

    return convert


def finite_and_within(value: float, metadata: Any) -> bool:
    """Whether a known number is finite and in its field's range."""
    return (
        math.isfinite(value)
        and value > metadata.get("above", -math.inf)
        and value >= metadata.get("at_least", -math.inf)
        and value < metadata.get("below", math.inf)
        and value <= metadata.get("at_most", math.inf)
    )


if TYPE_CHECKING:
    # A user gives a Python number, a law gets an array or a structural zero.
    Scalar: TypeAlias = Any
else:
    Scalar = Float[Array, ""]

# Some number, to see whether operations are traced, and where JAX says that nothing traces them.
ANY = np.zeros(())
with jax.ensure_compile_time_eval():
    EAGER = get_opaque_trace_state(convention="jaxclear")
# Compared as NumPy compares: jnp.float64 takes a microsecond each time.
FLOAT64 = np.dtype("float64")
# What NumPy would turn into a number, and nobody means as one.
NO_NUMBERS = (str, bytes, dict, list, tuple, bool, np.bool_, complex, np.complexfloating)


def as_number(value: Any) -> Any:
    """A float64 scalar (shape ()); `None` and modules pass through, anything else that is no number
    is refused.

    Raises `ValueError` for arrays with axes or text, `RuntimeError` where float64 has been switched
    off and in a forked process.
    """
    if value is None or isinstance(value, eqx.Module):
        return value
    check_not_forked()
    if isinstance(value, NO_NUMBERS) or getattr(value, "dtype", FLOAT64).kind not in "fiuV":
        raise ValueError(f"expected one number, got {described(value)}.")
    try:
        number = value if isinstance(value, jax.Array) else jnp.asarray(np.array(value, float))
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"expected one number, got {described(value)}.") from None
    if number.dtype != FLOAT64:
        check_double_precision()
        if number.dtype == bool or jnp.iscomplexobj(number):
            raise ValueError(f"expected one number, got one of type {number.dtype}.")
        number = number.astype(jnp.float64)
    if number.ndim != 0:
        raise ValueError(f"expected one number, got an array of shape {jnp.shape(number)}.")
    return number


def is_one_number(value: Any) -> bool:
    """Whether something is a real number, traced or not."""
    number = isinstance(value, (int, float, np.number, np.ndarray, jax.Array))
    return bool(number and jnp.shape(value) == () and jnp.isrealobj(value))


def as_vector(value: Any) -> Any:
    """A tuple of float64 scalars; `None` passes through (absent: structurally zero). Raises
    `ValueError` for one number.
    """
    if value is None:
        return None
    if not isinstance(value, (tuple, list)) and np.ndim(value) != 1:
        raise ValueError(
            f"expected several numbers, one for each direction, got {described(value)}."
        )
    components = tuple(as_number(component) for component in value)
    if any(component is None for component in components):
        raise ValueError("expected several numbers, got None among them.")
    return components


def concrete(value: Any) -> float | None:
    """The number, or None where it is absent or being traced."""
    return None if value is None or isinstance(value, jax.core.Tracer) else float(value)


def is_traced(tree: Any) -> bool:
    """Whether any number of a tree is being traced, so that nobody knows it yet; those that
    functions of Python's enclose, too."""
    leaves = jax.tree.leaves(tree)
    if not any(map(_may_be_traced, set(map(type, leaves)))):
        return False
    return any(
        isinstance(leaf, jax.core.Tracer) or (callable(leaf) and _has_traced_closure(leaf))
        for leaf in leaves
    )


@functools.cache
def _may_be_traced(kind: type) -> bool:
    """Whether things of a kind are traced, or functions that may enclose what is."""
    is_function = any("__call__" in vars(base) for base in kind.__mro__)
    return is_function or issubclass(kind, jax.core.Tracer)


def _has_traced_closure(function: Any) -> bool:
    """Whether a function of Python's hangs on a number that is being traced, by whatever it
    encloses: other functions, containers, objects with numbers."""
    near, visited = [function], set[int]()
    while near and len(visited) < MOST_ENCLOSED:
        if any(isinstance(one, jax.core.Tracer) for one in near):
            return True
        near = [one for one in near if id(one) not in visited]
        visited.update(map(id, near))
        near = [enclosed for one in near for enclosed in _contents_of(one)]
    return False


def _contents_of(one: Any) -> list:
    """What a function, a container or an object holds."""
    if isinstance(one, types.FunctionType):
        cells = [x.cell_contents for x in one.__closure__ or () if x != types.CellType()]
        return [*cells, *(one.__defaults__ or ()), *(one.__kwdefaults__ or {}).values()]
    if isinstance(one, types.MethodType):
        return [one.__self__, one.__func__]
    if isinstance(one, functools.partial):
        return [one.func, *one.args, *one.keywords.values()]
    if isinstance(one, Mapping):
        return list(one.values())
    if isinstance(one, (list, tuple)):
        return list(one)
    has_no_parts = isinstance(one, (type, types.ModuleType, jax.Array))
    return [] if has_no_parts else list(getattr(one, "__dict__", {}).values())


def on_host(tree: Any) -> Any:
    """A tree with NumPy's arrays in the place of JAX's, but for those that are traced: what is done
    with a few of its numbers then compiles nothing, and costs a microsecond in the place of ten."""
    is_array = lambda x: isinstance(x, jax.Array) and not isinstance(x, jax.core.Tracer)
    return jax.tree.map(lambda x: np.asarray(x) if is_array(x) else x, tree)


Of = TypeVar("Of", bound=eqx.Module)


def with_fields(module: Of, **values: Any) -> Of:
    """A module with other values in some fields, which are right and need no check: as
    `dataclasses.replace`, which takes a tenth of a millisecond to build a large one anew."""
    changed = copy.copy(module)
    for name, value in values.items():
        object.__setattr__(changed, name, value)
    return changed


def with_quantities(tree: Any) -> Any:
    """A tree, the quantities of its parts float64 arrays, in whatever form they were put in their
    places: `equinox.tree_at` and `jax.tree.map` do not ask the fields. A number of Python's would
    become a constant of the program, which is compiled anew for each."""
    leaves = jax.tree.leaves(tree)
    if all((eqx.is_array(x) and x.dtype == FLOAT64) or callable(x) for x in leaves):
        return tree
    inner = lambda x: isinstance(x, eqx.Module)
    if not inner(tree):
        return jax.tree.map(lambda x: with_quantities(x) if inner(x) else x, tree, is_leaf=inner)
    values: dict[str, Any] = {}
    kind: Any = type(tree)
    for name, metadata in _leaf_fields(kind):
        as_field = metadata.get("converter") if "unit" in metadata else None
        value = with_quantities(getattr(tree, name))
        values[name] = value if as_field is None else as_field(value)
    return with_fields(tree, **values)


class _NumbersAlone(eqx.Module):
    """A function in which numbers alone are leaves: `jax.jit` and `jax.vmap` return it."""

    numbers: Any
    rest: Any = eqx.field(static=True)

    def __call__(self, *args: Any) -> Any:
        return eqx.combine(self.numbers, self.rest)(*args)


def with_numbers_alone(tree: Any) -> Any:
    """A tree in which each function is one of which numbers alone are leaves."""
    close = lambda x: _NumbersAlone(*eqx.partition(x, eqx.is_array)) if callable(x) else x
    return close(tree) if callable(tree) else jax.tree.map(close, tree)


def is_tracing() -> bool:
    """Whether a program is being traced, whatever is known in it."""
    # An operation takes thirty times as long as the comparison, and `jax.vmap` alone traces none.
    eager = get_opaque_trace_state(convention="jaxclear") == EAGER
    return not eager and isinstance(jax.lax.neg_p.bind(ANY), jax.core.Tracer)


def on_device(numbers: Any) -> jax.Array:
    """As `jnp.asarray`, which compiles a program for every shape of numbers that are known."""
    if is_traced(numbers) or is_tracing():
        return jnp.asarray(numbers)
    if isinstance(numbers, float):
        return _number_on_device(np.float64(numbers).tobytes())
    return jax.device_put(np.asarray(numbers))


@functools.lru_cache(maxsize=64)
def _number_on_device(content: bytes) -> jax.Array:
    """A number of these bytes: JAX takes thirty microseconds to make one."""
    return jax.device_put(np.frombuffer(content).reshape(()))


def constant(tree: Any) -> Any:
    """A tree that is not to be differentiated."""
    traced = lambda x: isinstance(x, jax.core.Tracer)
    return jax.tree.map(lambda x: jax.lax.stop_gradient(x) if traced(x) else x, tree)


P, R = ParamSpec("P"), TypeVar("R")


def on_numbers(function: Callable[P, R]) -> Callable[P, R]:
    """The function, which NumPy and Python evaluate: a `ValueError` with a sentence where an
    argument is being traced."""

    @functools.wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except jax.errors.JAXTypeError as error:
            raise ValueError(
                f"{function.__qualname__} is worked out from numbers, which are being traced (by "
                "jax.jit, vmap or a derivative): read it of a run outside the function that is "
                'traced, and take arrays inside, such as run.coordinate("A").'
            ) from error

    return called


def quantity(
    default: Any = dataclasses.MISSING,
    unit: str = "1",
    meaning: str = "",
    *,
    above: float | None = None,
    at_least: float | None = None,
    below: float | None = None,
    at_most: float | None = None,
    **kwargs: Any,
) -> Any:
    """Declare a field that holds one number with a unit and a range.

    The range is checked when an object is built (see `AbstractQuantified`) and for every sample of
    a study.

    Args:
        default: a number, or None where the number may be absent; without it the field is required.
        unit: SI unit; "1" (default) for a number without.
        meaning: what the number is, part of a sentence; by default what `Args:` in the docstring of
            the class says up to the unit.
        above: exclusive lower bound [unit]; None (default) for none.
        at_least: inclusive lower bound [unit]; None (default) for none.
        below: exclusive upper bound [unit]; None (default) for none.
        at_most: inclusive upper bound [unit]; None (default) for none.
        kwargs: further arguments of `equinox.field`; `converter` for a field that accepts more than
            one number; `usual`, (least, largest, likely mistake) [unit] of usual mechanisms, beyond
            which a `Mechanism` warns; `wanted`, what the field accepts, in words; `sliding`, the
            unit of a joint that slides, where `unit` is that of one that turns.

    Returns:
        The field.
    """
    bounds = {"above": above, "at_least": at_least, "below": below, "at_most": at_most}
    metadata = {k: v for k, v in bounds.items() if v is not None}
    metadata |= {k: kwargs.pop(k) for k in METADATA if k in kwargs}
    converter = kwargs.pop("converter", as_number)
    return _make_field(default, unit, meaning, converter, kwargs, metadata)


# Metadata of a field that a check reads: numbers of a vector, what it must be in words, its usual
# range, its unit where a joint slides.
METADATA = ("counts", "usual", "wanted", "sliding")


def vector(
    default: Any = dataclasses.MISSING,
    unit: str = "1",
    meaning: str = "",
    *,
    counts: tuple[int, ...] = (),
    **kwargs: Any,
) -> Any:
    """Declare a field that holds several numbers with one unit, each a leaf of its own.

    Args:
        default: numbers, or None where they may be absent; without it the field is required.
        unit: SI unit; "1" (default) for numbers without.
        meaning: what the numbers are, part of a sentence; "" by default.
        counts: allowed numbers of components; any (default) where empty.
        kwargs: further arguments of `equinox.field`; `converter`, `usual` and `wanted` as of
            `quantity`.

    Returns:
        The field.
    """
    metadata = {"counts": counts} | {k: kwargs.pop(k) for k in METADATA if k in kwargs}
    return _make_field(default, unit, meaning, kwargs.pop("converter", as_vector), kwargs, metadata)


def count(default: Any = dataclasses.MISSING, meaning: str = "", at_least: int = 1, **kwargs: Any):
    """Declare a static field that holds a whole number.

    Args:
        default: the number; without it the field is required.
        meaning: what is counted, part of a sentence; "" by default.
        at_least: smallest number allowed; 1 by default.
        kwargs: further arguments of `equinox.field`.

    Returns:
        The field.
    """
    metadata = {"at_least": at_least, "meaning": meaning}
    if default is not dataclasses.MISSING:
        kwargs["default"] = default
    return eqx.field(static=True, metadata=metadata, converter=_as_python_integer, **kwargs)


def _as_python_integer(value: Any) -> Any:
    """NumPy's whole numbers as Python's."""
    return int(value) if isinstance(value, np.integer) else value


def _make_field(default, unit, meaning, converter, kwargs, further):
    metadata = {"unit": unit, "meaning": meaning} | further
    if default is not dataclasses.MISSING:
        kwargs["default"] = default
    return eqx.field(converter=lenient_converter(converter), metadata=metadata, **kwargs)


class AbstractQuantified(AbstractShown, metaclass=AnsweringMeta):
    """Base class of everything that has numbers with units.

    Building an object checks its fields: `integrator.MoreauJean has gamma = -1; it must be at least
    0.` A `__check_init__` of a subclass runs after that. `print` shows the numbers with their
    units. A class that derives from it declares its numbers by `jaxclear.quantity` and
    `jaxclear.vector`.

    Raises:
        ValueError: if a field holds a value of the wrong kind, a number that is not finite or
            outside its range.
    """

    def _summary(self):
        return part_in_words(self)

    def __check_init__(self):
        if "__check_init__" not in vars(type(self)):
            type(self)._check_fields(self)

    def _check_fields(self):
        owner = lambda: public_name(type(self))
        check_kinds(owner, self)
        for name, metadata in _fields_with_units(type(self)):
            for path, leaf, field_metadata in _iterate_numbers(getattr(self, name), name, metadata):
                check_range(owner, path, leaf, field_metadata)


@functools.cache
def _fields_with_units(kind: type) -> tuple[tuple[str, Mapping], ...]:
    """The fields of a class that hold numbers with a unit."""
    return tuple((f.name, f.metadata) for f in dataclasses.fields(kind) if "unit" in f.metadata)


@functools.cache
def _leaf_fields(kind: type) -> tuple[tuple[str, Mapping], ...]:
    """The fields of a class that are not static: looking them up anew costs more than a check."""
    fields = dataclasses.fields(kind)
    return tuple((f.name, f.metadata) for f in fields if not f.metadata.get("static", False))


def check_range(owner: Callable[[], str], path: str, leaf: Any, metadata: Mapping) -> None:
    """Raises `ValueError` for a number that is not finite or outside its range; traced ones pass.

    Args:
        owner: function that names whose number it is, called only for the message.
        path: name of the number in the message.
        leaf: number or array.
        metadata: of its field: unit and bounds.
    """
    if "unit" not in metadata or isinstance(leaf, jax.core.Tracer):
        return
    # A Python number: comparing it costs a tenth of what an array's costs, and every call builds
    # objects.
    value = float(leaf) if leaf.ndim == 0 else leaf
    if (
        finite_and_within(value, metadata)
        if isinstance(value, float)
        else np.all(inside(leaf, metadata))
    ):
        return
    unit = "" if metadata["unit"] == "1" else f" {metadata['unit']}"
    required = [range_in_words(metadata)] if range_in_words(metadata) else []
    required += [] if np.all(np.isfinite(leaf)) else ["finite"]
    value_text = (
        f"{value:g}" if isinstance(value, float) else np.array2string(np.asarray(leaf), threshold=6)
    )
    raise ValueError(
        f"{owner()} has {path} = {value_text}{unit}; it must be {' and '.join(required)}."
    )


def numbers(tree: Any, name: str = "") -> Iterator[tuple[str, Any, Mapping[str, Any]]]:
    """(name, leaf, metadata of its field) of every number in a mechanism or any part of it, in
    definition order; `name` is what the tree itself is called."""
    return _iterate_numbers(tree, name, {})


def inside(leaf: Any, metadata: Mapping[str, Any]) -> Any:
    """True where a number lies in its field's range; works on traced numbers."""
    # A number that is known stays known within a program that is being traced.
    library = jnp if isinstance(leaf, jax.core.Tracer) else np
    leaf = library.asarray(leaf)
    fits = library.isfinite(leaf)
    if "above" in metadata:
        fits = fits & (leaf > metadata["above"])
    if "at_least" in metadata:
        fits = fits & (leaf >= metadata["at_least"])
    if "below" in metadata:
        fits = fits & (leaf < metadata["below"])
    return fits & (leaf <= metadata["at_most"]) if "at_most" in metadata else fits


def _iterate_numbers(tree, path, metadata):
    if isinstance(tree, jax.Array):
        yield path, tree, metadata
    elif isinstance(tree, eqx.Module):
        for name, field_metadata in _leaf_fields(type(tree)):
            inner = f"{path}.{name}" if path else name
            value = getattr(tree, name)
            if isinstance(value, jax.Array):
                yield inner, value, specify_unit(tree, field_metadata)
            elif value is not None:
                yield from _iterate_numbers(value, inner, field_metadata)
    elif isinstance(tree, dict):
        for key, value in tree.items():
            yield from _iterate_numbers(value, f'{path}["{key}"]', metadata)
    elif isinstance(tree, (tuple, list)):
        for index, value in enumerate(tree):
            yield from _iterate_numbers(value, f"{path}[{index}]", metadata)
    elif eqx.is_array(tree):
        yield path, tree, metadata
