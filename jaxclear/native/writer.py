"""A small JAX program written as LLVM code: every number of every (small) array becomes one virtual
register.

`Writer` keeps the text; a `rule` says what one of JAX's primitives becomes: `(writer, equation,
*inputs)` to the outputs, on NumPy object arrays of registers and known numbers. Registers hold one
sample, or a vector of `lanes` samples side by side. Shapes are NumPy's business (reshape,
broadcast, transpose move names about and cost nothing); arithmetic writes one instruction for each
number. What has no rule raises `Unsupported`: the caller then leaves the program to XLA. The rules
stand in `arithmetic`, `elementary`, `indexing` and `control`.
"""

import hashlib
import math
import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.extend.core import ClosedJaxpr, DropVar, Jaxpr, Literal

FLOAT, INT, TRUTH = "double", "i64", "i1"
# The flag that stops all kernels, which each process has elsewhere (`stopping`).
STOP_FLAG = "@jaxclear_stop_flag"
# Of a function that does nothing but return a number: of two alike calls LLVM keeps one (of C's
# functions too: nobody reads the error number that they may set).
PURE = "nounwind willreturn memory(none)"
# Beyond this many instructions XLA's loops over arrays are the better program. Of 190 000, for the
# derivative by all numbers of a ball, LLVM made a kernel in 30 s of CPU time; XLA took over 280 s.
MOST_INSTRUCTIONS = 250_000
# An array longer than this stays in memory and is read by index; shorter ones live in registers.
LONGEST_IN_REGISTERS = 64


class Unsupported(Exception):
    """The program has a part that this module does not write."""


def kind_of(dtype: Any) -> str:
    """The LLVM type of one number of a NumPy type."""
    dtype = np.dtype(dtype)
    if dtype == np.float64:
        return FLOAT
    if dtype == np.bool_:
        return TRUTH
    if dtype in (np.int32, np.int64):
        return INT
    raise Unsupported(f"numbers of type {dtype}")


class InMemory:
    """An array that is read by index: registers with its place in memory for each sample, and its
    shape for one sample. `version`: of one that changes, how often it had when this was it.
    """

    def __init__(self, places: list[str], shape: tuple[int, ...], version: int | None = None):
        self.places, self.shape, self.version = places, shape, version

    def reshaped(self, shape: tuple[int, ...]) -> "InMemory":
        """The same numbers in another shape."""
        return InMemory(self.places, shape, self.version)


class Long:
    """An array too long for registers, which stands in memory or is looked up there: `entry` makes
    a register of its entry at a row-major index, known or in a register that is one for all
    samples. `buffer`: the memory that it stands in by itself (None: it is looked up)."""

    def __init__(self, shape: tuple[int, ...], kind: str, entry: Callable, buffer: Any = None):
        self.shape, self.kind, self.entry, self.buffer = tuple(shape), kind, entry, buffer
        self.size = math.prod(self.shape)

    def reshaped(self, shape: tuple[int, ...]) -> "Long":
        """The same numbers in another shape."""
        return Long(shape, self.kind, self.entry, self.buffer)


class Writer:
    """LLVM text under construction. A value is a register's name or a Python number; arrays are
    NumPy object arrays of them. `leaves_rows`: its turns do; `checked`: its outermost loop takes
    one turn, whatever its condition says, to be compared (`check`).
    """

    def __init__(self, lanes: int, leaves_rows: bool = False, checked: bool = False):
        self.lanes, self.leaves_rows, self.checked = lanes, leaves_rows, checked
        # Loops within one another, at the place that is being written.
        self.depth = 0
        self.lines: list[str] = []
        self.needs: set[str] = set()
        self.block = "entry"
        self.active: str | None = None
        # Register with the turn of a scan, the same for all samples.
        self.turn = ""
        self._count = 0
        # What the kernel keeps on its stack, and how much that is [bytes].
        self.frame: list[str] = []
        self.memory = 0
        # Registers that can be read here, by their right-hand sides, as they came.
        self._registers: dict[str, str] = {}
        # Patterns of linear systems by number, memory for their factors, and whose it holds here
        # (`linear_systems`).
        self.patterns: dict[Any, int] = {}
        self.factors: dict[tuple[int, int], Any] = {}
        self.owners: dict[tuple, int] = {}
        # How often arrays in memory have changed, by the register of the first sample's place.
        self._versions: dict[str, int] = {}

    def wide(self, kind: str) -> str:
        """The type of a register."""
        return kind if self.lanes == 1 else f"<{self.lanes} x {kind}>"

    def fresh(self, prefix: str = "v") -> str:
        self._count += 1
        if self._count > MOST_INSTRUCTIONS:
            raise Unsupported("a program this long")
        return f"%{prefix}{self._count}"

    def text(self, value: Any, kind: str) -> str:
        """A value as an operand."""
        if isinstance(value, str):
            return value
        if kind == FLOAT:
            word = f"0x{struct.unpack('<Q', struct.pack('<d', float(value)))[0]:016X}"
        else:
            word = str(int(value)) if kind == INT else ("true" if value else "false")
        return word if self.lanes == 1 else f"splat ({kind} {word})"

    def put(self, right: str) -> str:
        """A register holding the right-hand side: that of before, where the same was written within
        the current region, of what no memory that changes has a part in."""
        if right.startswith("load") and "!invariant" not in right:
            return self._new_register(right)
        if right not in self._registers:
            self._registers[right] = self._new_register(right)
        return self._registers[right]

    def _new_register(self, right: str) -> str:
        name = self.fresh()
        self.lines.append(f"  {name} = {right}")
        return name

    def say(self, line: str) -> None:
        self.lines.append("  " + line)

    def start(self, label: str) -> None:
        self.lines.append(f"{label}:")
        self.block = label

    def enter(self) -> int:
        """Open a region whose registers are not visible behind it; hand the result to `leave`."""
        self.owners.clear()
        return len(self._registers)

    def leave(self, before: int) -> None:
        self.owners.clear()
        while len(self._registers) > before:
            self._registers.popitem()

    def operate(self, form: str, kind: str, *values: Any) -> str:
        """`form` with {type} and the operands {0}, {1}, ..."""
        return self.put(form.format(*[self.text(v, kind) for v in values], type=self.wide(kind)))

    def call(self, name: str, *values: Any) -> str:
        """A function of floats from LLVM's intrinsics ("sqrt") or this package's own
        ("jc.sincos")."""
        suffix = "f64" if self.lanes == 1 else f"v{self.lanes}f64"
        full = f"@llvm.{name}.{suffix}"
        wide = self.wide(FLOAT)
        self.needs.add(f"declare {wide} {full}({', '.join([wide] * len(values))})")
        operands = ", ".join(f"{wide} {self.text(v, FLOAT)}" for v in values)
        return self.put(f"call {wide} {full}({operands})")

    def call_defined(self, name: str, *values: Any) -> str:
        """A function of floats that `functions` defines."""
        wide = self.wide(FLOAT)
        self.needs.add(name)
        result = f"{{{wide}, {wide}}}" if name == "sincos" else wide
        operands = ", ".join(f"{wide} {self.text(v, FLOAT)}" for v in values)
        return self.put(f"call {result} @jc.{name}({operands})")

    def lane(self, value: Any, kind: str, lane: int) -> str:
        """One sample's number out of a register.

        Args:
            value: register name or Python number.
            kind: of its numbers: `FLOAT`, `INT` or `TRUTH`.
            lane: which of the samples that the kernel takes at once.
        """
        if self.lanes == 1 or not isinstance(value, str):
            if isinstance(value, str):
                return value
            alone = Writer(1)
            return alone.text(value, kind)
        return self.put(f"extractelement {self.wide(kind)} {value}, i64 {lane}")

    def gather_lanes(self, parts: list[str], kind: str) -> str:
        """A register from one number per sample."""
        if self.lanes == 1:
            return parts[0]
        value = "poison"
        for lane, part in enumerate(parts):
            value = self.put(f"insertelement {self.wide(kind)} {value}, {kind} {part}, i64 {lane}")
        return value

    def spread(self, number: str, kind: str) -> str:
        """A register that holds one number for every sample."""
        if self.lanes == 1:
            return number
        wide = self.wide(kind)
        first = self.put(f"insertelement {wide} poison, {kind} {number}, i64 0")
        zeros = f"<{self.lanes} x i32> zeroinitializer"
        return self.put(f"shufflevector {wide} {first}, {wide} poison, {zeros}")

    def table(self, numbers: Any, kind: str = "i32") -> str:
        """Numbers that are known, in memory."""
        word = (lambda x: str(int(x))) if kind == "i32" else (lambda x: Writer(1).text(x, kind))
        words = ", ".join(f"{kind} {word(x)}" for x in numbers)
        name = f"@NAME.table{hashlib.sha256(words.encode()).hexdigest()[:16]}"
        self.needs.add(f"{name} = private constant [{len(numbers)} x {kind}] [{words}]")
        return name

    def library(self, name: str, *values: Any) -> str:
        """A function of the C mathematical library, called for each sample."""
        self.needs.add(f"declare double @{name}({', '.join(['double'] * len(values))}) {PURE}")
        parts = []
        for lane in range(self.lanes):
            operands = ", ".join(f"double {self.lane(v, FLOAT, lane)}" for v in values)
            parts.append(self.put(f"call double @{name}({operands})"))
        return self.gather_lanes(parts, FLOAT)

    def read(self, array: InMemory, flat_index: Any) -> str:
        """The entry of an array in memory at a row-major index."""
        self.check_latest(array)
        stays = ", !invariant.load !0" if array.version is None else ""
        parts = [
            self.put(f"load double, ptr {place}{stays}")
            for place in self._addresses_of_entries(array, flat_index)
        ]
        return self.gather_lanes(parts, FLOAT)

    def part(self, array: InMemory, flat_index: Any, shape: tuple[int, ...]) -> InMemory:
        """Consecutive numbers of an array in memory that never changes.

        Args:
            array: in memory.
            flat_index: row-major index of the first of them, known or in a register.
            shape: of the result.
        """
        return InMemory(self._addresses_of_entries(array, flat_index), shape)

    def change(self, array: InMemory, entries: list[tuple[Any, Any]]) -> InMemory:
        """The array once entries at row-major indices have been given these numbers; as it was it
        can be read no more. Samples that have ended keep theirs."""
        for flat_index, value in entries:
            places = self._addresses_of_entries(array, flat_index)
            if self.active is not None:
                old = self.read(array, flat_index)
                value = self.choose(self.active, value, old, FLOAT)
            # All samples are read before any is written: one may stand in the place of another.
            numbers = [self.lane(value, FLOAT, lane) for lane in range(self.lanes)]
            for number, place in zip(numbers, places, strict=True):
                self.say(f"store double {number}, ptr {place}")
        return self.renewed(array)

    def renewed(self, array: InMemory) -> InMemory:
        """An array that has changed, or may have. Raises `Unsupported` for one that may not."""
        self.check_latest(array)
        if array.version is None:
            raise Unsupported("a long array that changes")
        self._versions[array.places[0]] = array.version + 1
        return InMemory(array.places, array.shape, array.version + 1)

    def check_latest(self, array: InMemory) -> None:
        """Raises `Unsupported` for an array as it was before it changed."""
        if array.version != self._versions.get(array.places[0], array.version):
            raise Unsupported("a long array as it was before it changed")

    def _addresses_of_entries(self, array: InMemory, flat_index: Any) -> list[str]:
        """Registers with the place of each sample's entry."""
        return [
            self.put(f"getelementptr double, ptr {start}, i64 {self.lane(flat_index, INT, lane)}")
            for lane, start in enumerate(array.places)
        ]

    def copy(self, source: InMemory, targets: list[str], count: int) -> None:
        """Writes a copy of each sample's array in memory.

        Args:
            source: array in memory, in its latest version.
            targets: registers with the place for each sample.
            count: numbers of a sample.
        """
        self.check_latest(source)
        name = "@llvm.memcpy.p0.p0.i64"
        self.needs.add(f"declare void {name}(ptr, ptr, i64, i1)")
        for start, target in zip(source.places, targets, strict=True):
            self.say(f"call void {name}(ptr {target}, ptr {start}, i64 {8 * count}, i1 false)")

    def any(self, truth: Any) -> str:
        """Whether it holds for one of the samples, as a single i1."""
        word = self.text(truth, TRUTH)
        if self.lanes == 1:
            return word
        name = f"@llvm.vector.reduce.or.v{self.lanes}i1"
        self.needs.add(f"declare i1 {name}({self.wide(TRUTH)})")
        return self.put(f"call i1 {name}({self.wide(TRUTH)} {word})")

    def most(self, truth: Any, among: Any) -> str:
        """Whether it holds for more than half of some samples (None: of all), as a single i1; of
        one sample whether it holds."""
        if self.lanes == 1:
            return self.any(truth)
        self.needs.add("declare i64 @llvm.ctpop.i64(i64)")
        counts = []
        for each in (truth, True if among is None else among):
            word = f"{self.wide(TRUTH)} {self.text(each, TRUTH)}"
            bits = self.put(f"bitcast {word} to i{self.lanes}")
            bits = self.put(f"zext i{self.lanes} {bits} to i64")
            counts.append(self.put(f"call i64 @llvm.ctpop.i64(i64 {bits})"))
        return self.put(
            f"icmp ugt i64 {self.put(f'add i64 {counts[0]}, {counts[0]}')}, {counts[1]}"
        )

    def choose(self, truth: Any, yes: Any, no: Any, kind: str) -> Any:
        """`yes` where `truth` holds, else `no`.

        Args:
            truth: register name, or Python bool, which writes no code.
            yes, no: register names or Python numbers.
            kind: of both: `FLOAT`, `INT` or `TRUTH`.
        """
        if not isinstance(truth, str):
            return yes if truth else no
        if isinstance(yes, str) and yes == no:
            return yes
        wide = self.wide(kind)
        return self.put(
            f"select {self.wide(TRUTH)} {truth}, {wide} {self.text(yes, kind)}, {wide} "
            f"{self.text(no, kind)}"
        )


Rule = Callable[..., Any]
RULES: dict[str, Rule] = {}
# Names of the rules that take arrays in memory as well.
READ_MEMORY: set[str] = set()
# Rules of primitives of which some inputs are long arrays; others are given their entries.
LONG_RULES: dict[str, Rule] = {}


def rule(*names: str, reads_memory: bool = False) -> Callable[[Rule], Rule]:
    """Registers the rule of some primitives; `reads_memory`: it takes arrays in memory as well."""

    def keep(function: Rule) -> Rule:
        RULES.update(dict.fromkeys(names, function))
        READ_MEMORY.update(names if reads_memory else ())
        return function

    return keep


def long_rule(*names: str) -> Callable[[Rule], Rule]:
    """Registers the rule of some primitives where one of their inputs is a long array."""

    def keep(function: Rule) -> Rule:
        LONG_RULES.update(dict.fromkeys(names, function))
        return function

    return keep


def array_of(values: Any, shape: tuple[int, ...]) -> np.ndarray:
    """An object array filled with registers or numbers."""
    out = np.empty(shape, object)
    out[...] = values
    return out


def number_of(value: Any) -> Any:
    """A NumPy scalar as a Python number."""
    return value.item() if isinstance(value, (np.generic, np.ndarray)) else value


def write(writer: Writer, jaxpr: Jaxpr, constants: Any, arguments: Any) -> list:
    """Writes a JAX program and returns its outputs, object arrays of registers or `InMemory`.

    Args:
        writer: LLVM text under construction.
        jaxpr: the program.
        constants, arguments: arrays of registers or numbers for its constants and inputs.

    Raises:
        Unsupported: a primitive has no rule, or none for long arrays.
    """
    values: dict[Any, Any] = dict(zip(jaxpr.constvars, constants, strict=True))
    values |= dict(zip(jaxpr.invars, arguments, strict=True))

    def get(atom):
        if isinstance(atom, Literal):
            if atom.aval.dtype == np.uint64 and np.ndim(atom.val) == 0:
                return array_of(int(np.asarray(atom.val, np.uint64).view(np.int64)), ())
            kind_of(atom.aval.dtype)
            return (
                array_of(number_of(atom.val), ())
                if np.ndim(atom.val) == 0
                else np.asarray(atom.val).astype(object)
            )
        return values[atom]

    for equation in jaxpr.eqns:
        name = equation.primitive.name
        if name not in RULES:
            raise Unsupported(f"the primitive {name}")
        inputs = [get(atom) for atom in equation.invars]
        rule = RULES[name]
        if name == "unstack":
            equation = equation.replace(outvars=read_alone(equation.outvars, jaxpr))
        refused = name not in READ_MEMORY and any(isinstance(value, InMemory) for value in inputs)
        if name in LONG_RULES and (refused or any(isinstance(value, Long) for value in inputs)):
            rule, refused = LONG_RULES[name], False
        else:
            inputs = [in_registers(value) for value in inputs]
        if refused:
            raise Unsupported(f"{name} of a long array")
        outputs = rule(writer, equation, *inputs)
        values |= dict(
            zip(equation.outvars, outputs if isinstance(outputs, list) else [outputs], strict=True)
        )
    return [get(atom) for atom in jaxpr.outvars]


def read_alone(variables: Sequence[Any], jaxpr: Jaxpr) -> list[Any]:
    """Variables of a program; those that it never reads are marked as such."""
    atoms = [atom for equation in jaxpr.eqns for atom in equation.invars] + jaxpr.outvars
    read = {atom for atom in atoms if not isinstance(atom, Literal)}
    return [v if v in read else DropVar(v.aval) for v in variables]


def in_registers(array: Any) -> Any:
    """The entries of a long array one by one; any other as it is."""
    if not isinstance(array, Long):
        return array
    entries = array_of(None, (array.size,))
    for k in range(array.size):
        entries[k] = array.entry(k)
    return entries.reshape(array.shape)


def write_closed(writer: Writer, program: Any, arguments: Any) -> list:
    """Writes a program whose constants are known; returns its outputs.

    Args:
        writer: LLVM text under construction.
        program: closed JAX program, or one without constants.
        arguments: arrays of registers or numbers for its inputs.
    """
    if isinstance(program, ClosedJaxpr):
        return write(writer, program.jaxpr, [constant_array(c) for c in program.consts], arguments)
    return write(writer, program, [], arguments)


def constant_array(value: Any) -> np.ndarray:
    """A NumPy array of numbers as an object array of Python numbers."""
    plain = np.asarray(value)
    kind_of(plain.dtype)
    return plain.astype(object)


def refuse_memory(*arrays: Any) -> None:
    """Raises `Unsupported` where one of them is kept in memory."""
    if any(isinstance(a, InMemory) for a in arrays):
        raise Unsupported("a long array that changes")


def kinds_of(equation: Any) -> list[str]:
    """The LLVM types of an equation's inputs."""
    return [kind_of(atom.aval.dtype) for atom in equation.invars]


def each(function: Callable, *arrays: np.ndarray) -> np.ndarray:
    """A function of single numbers over arrays of one shape (or scalars)."""
    shape = arrays[0].shape
    if any(a.shape != shape for a in arrays):
        shape = np.broadcast_shapes(*[a.shape for a in arrays])
        arrays = tuple(np.broadcast_to(a, shape) for a in arrays)
    if shape == ():
        return array_of(function(*[a.item() for a in arrays]), ())
    out = np.empty(math.prod(shape), object)
    for k, numbers in enumerate(zip(*[a.ravel().tolist() for a in arrays], strict=True)):
        out[k] = function(*numbers)
    return out.reshape(shape)


def is_num(*values: Any) -> bool:
    """Whether all are numbers known while writing."""
    return not any(isinstance(v, str) for v in values)
