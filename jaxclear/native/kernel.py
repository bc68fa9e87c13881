"""Machine code of a whole while loop, called from compiled JAX programs.

The loop is written by the rules, compiled by LLVM, checked on random numbers, and made known to XLA
under a name that its text decides. Samples run `lanes` at a time.
"""

import hashlib
from typing import Any, NamedTuple

import numpy as np

from jaxclear.native import (  # noqa: F401  (rules register themselves when imported)
    call_frame,
    elementary,
    functions,
    indexing,
    shapes,
)
from jaxclear.native.check import check
from jaxclear.native.control import loop
from jaxclear.native.program import Program, avals_of, floats_in, in_memory
from jaxclear.native.rules import array_of, write_closed
from jaxclear.native.writer import FLOAT, TRUTH, WHOLE, InMemory, Writer, kind_of


class Kernel(NamedTuple):
    """Compiled code: the name under which XLA knows it, and its address for a direct call."""

    name: str
    address: int


def text_of(program: Program, lanes: int) -> str:
    """The loop as LLVM code, function `NAME.loop(in, out, big, most)`, and what it calls."""
    writer = Writer(lanes)
    values = _arguments(writer, program)
    c, b = program.condition_constants, program.body_constants
    fixed_condition, fixed_body, first = values[:c], values[c : c + b], values[c + b :]
    kinds = [kind_of(a.dtype) for a in avals_of(program)[1]]
    forced = writer.put("icmp sgt i64 %most, 0")
    most = writer.put(f"select i1 {forced}, i64 %most, i64 {2**62}")
    last = loop(
        writer,
        lambda s: write_closed(writer, program.condition, [*fixed_condition, *s])[0].item(),
        lambda s: write_closed(writer, program.body, [*fixed_body, *s]),
        first,
        kinds,
        most,
    )
    numbers = [
        (value, kind) for array, kind in zip(last, kinds, strict=True) for value in array.flat
    ]
    for position, (value, kind) in enumerate(numbers):
        _store(writer, position, value, kind)
    head = (
        "define internal void @NAME.loop(ptr noalias %in, ptr noalias %out, ptr noalias %big, "
        "i64 %most) {\nentry:"
    )
    parts = [head, *writer.lines, "  ret void\n}"]
    needs = set(writer.needs)
    for name, make in functions.OWN.items():
        if name in needs:
            lines, further = make(lanes)
            parts, needs = [*lines, *parts], (needs - {name}) | further
    return "\n".join([*sorted(needs), *parts, "!0 = !{}"])


def _arguments(writer: Writer, program: Program) -> list:
    """Constants and first state: arrays of registers, loaded one by one, or arrays in memory."""
    constants, state = avals_of(program)
    position, slot = 0, 0
    values: list[Any] = []
    for aval, long in zip([*constants, *state], in_memory(program), strict=True):
        kind, shape = kind_of(aval.dtype), tuple(aval.shape)
        if long:
            first = slot * writer.lanes
            places = [
                writer.put(f"getelementptr ptr, ptr %big, i64 {first + lane}")
                for lane in range(writer.lanes)
            ]
            starts = [writer.put(f"load ptr, ptr {place}") for place in places]
            values.append(InMemory(starts, shape))
            slot += 1
            continue
        array = array_of(None, shape)
        for index in np.ndindex(*shape):
            array[index] = _load(writer, position, kind)
            position += 1
        values.append(array)
    return values


def _load(writer: Writer, position: int, kind: str) -> str:
    place = writer.put(f"getelementptr double, ptr %in, i64 {position * writer.lanes}")
    value = writer.put(f"load {writer.wide(FLOAT)}, ptr {place}")
    if kind == WHOLE:
        return writer.put(f"fptosi {writer.wide(FLOAT)} {value} to {writer.wide(WHOLE)}")
    return writer.operate("fcmp une {type} {0}, {1}", FLOAT, value, 0.0) if kind == TRUTH else value


def _store(writer: Writer, position: int, value: Any, kind: str) -> None:
    place = writer.put(f"getelementptr double, ptr %out, i64 {position * writer.lanes}")
    word = writer.text(value, kind)
    if kind != FLOAT:
        word = writer.put(
            f"{'sitofp' if kind == WHOLE else 'uitofp'} {writer.wide(kind)} {word} to "
            f"{writer.wide(FLOAT)}"
        )
    writer.say(f"store {writer.wide(FLOAT)} {word}, ptr {place}")


def _machine() -> Any:
    """LLVM's description of this processor; an engine takes it over, so each needs its own."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    features = llvm.get_host_cpu_features().flatten()
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(
        opt=3, cpu=llvm.get_host_cpu_name(), features=features, jit=True
    )


def widest() -> int:
    """Samples that one vector register of this processor holds, twice over where registers are
    short.
    """
    import llvmlite.binding as llvm

    return 8 if llvm.get_host_cpu_features().get("avx512f") else 4


_ENGINES: dict[str, tuple[Any, Kernel]] = {}


def build(program: Program, lanes: int) -> Kernel:
    """Compile, register with XLA, and check. Raises `Unsupported`."""
    call_frame.interface_version()
    text = text_of(program, lanes)
    constants, state = avals_of(program)
    kept = list(zip([*constants, *state], in_memory(program), strict=True))
    long = [aval for aval, is_long in kept if is_long]
    mark = hashlib.sha256(f"{text}{lanes}{[a.shape for a in long]}".encode()).hexdigest()[:24]
    name = f"jaxclear_{mark}"
    if name in _ENGINES:
        return _ENGINES[name][1]
    frame = call_frame.text(
        name,
        lanes,
        width=floats_in([aval for aval, is_long in kept if not is_long]),
        height=floats_in(state),
        in_memory=[int(np.prod(aval.shape)) for aval in long],
    )
    engine = _compiled(text.replace("@NAME", f"@{name}") + frame)
    kernel = Kernel(name, engine.get_function_address(f"{name}.samples"))
    check(program, kernel.address)
    call_frame.register(name, engine.get_function_address(name))
    _ENGINES[name] = (engine, kernel)
    return kernel


def _compiled(text: str) -> Any:
    """An engine that holds the machine code; the code lives as long as it does."""
    import llvmlite.binding as llvm

    module = llvm.parse_assembly(text)
    machine = _machine()
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    passes = llvm.create_pass_builder(machine, options)
    passes.getModulePassManager().run(module, passes)
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    return engine
