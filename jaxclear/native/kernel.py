"""Machine code of a whole while loop, called from compiled JAX programs through XLA's foreign
function interface.

A kernel takes one packed row of floats per sample (constants and first state; whole numbers and
truth values as floats, which is exact to 2^53) and arrays read by index, and gives one packed row,
the last state. Samples run `lanes` at a time. Each kernel is checked against JAX's own evaluation
of one turn before it is used.
"""

import ctypes
import functools
import hashlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr

from jaxclear.native import check as checking
from jaxclear.native import control, functions, shapes  # noqa: F401  (rules register themselves)
from jaxclear.native.control import loop
from jaxclear.native.rules import array_of, write_closed
from jaxclear.native.writer import (
    FLOAT,
    LONGEST_IN_REGISTERS,
    TRUTH,
    WHOLE,
    InMemory,
    Unsupported,
    Writer,
    kind_of,
)

# Fields of XLA's call frame as this module reads them (offsets in bytes); `interface_version`
# checks that they still hold.
HANDLER = """
define ptr @{name}(ptr %frame) {{
entry:
  %extension_place = getelementptr i8, ptr %frame, i64 8
  %extension = load ptr, ptr %extension_place
  %plain = icmp eq ptr %extension, null
  br i1 %plain, label %execute, label %describe
describe:
  %metadata_place = getelementptr i8, ptr %extension, i64 24
  %metadata = load ptr, ptr %metadata_place
  %major = getelementptr i8, ptr %metadata, i64 24
  store i32 {major}, ptr %major
  %minor = getelementptr i8, ptr %metadata, i64 28
  store i32 {minor}, ptr %minor
  %traits = getelementptr i8, ptr %metadata, i64 32
  store i32 0, ptr %traits
  %state = getelementptr i8, ptr %metadata, i64 40
  store i64 0, ptr %state
  ret ptr null
execute:
  %arguments_place = getelementptr i8, ptr %frame, i64 72
  %arguments = load ptr, ptr %arguments_place
  %results_place = getelementptr i8, ptr %frame, i64 112
  %results = load ptr, ptr %results_place
  %first = load ptr, ptr %arguments
  %rank_place = getelementptr i8, ptr %first, i64 32
  %rank = load i64, ptr %rank_place
  %sizes_place = getelementptr i8, ptr %first, i64 40
  %sizes = load ptr, ptr %sizes_place
  %outer = sub i64 %rank, 1
  br label %count
count:
  %axis = phi i64 [ 0, %execute ], [ %next_axis, %multiply ]
  %samples = phi i64 [ 1, %execute ], [ %more, %multiply ]
  %counted = icmp sge i64 %axis, %outer
  br i1 %counted, label %gather, label %multiply
multiply:
  %size_place = getelementptr i64, ptr %sizes, i64 %axis
  %size = load i64, ptr %size_place
  %more = mul i64 %samples, %size
  %next_axis = add i64 %axis, 1
  br label %count
gather:
  %data = alloca ptr, i64 {arrays}
{loads}
  %result = load ptr, ptr %results
  %out_place = getelementptr i8, ptr %result, i64 24
  %out = load ptr, ptr %out_place
  call void @{name}.samples(ptr %data, ptr %out, i64 %samples, i64 0)
  ret ptr null
}}
"""
SAMPLES = """
define void @{name}.samples(ptr %data, ptr %out, i64 %samples, i64 %most) {{
entry:
  %in = alloca [{inputs} x double], align 64
  %given = alloca [{outputs} x double], align 64
  %big = alloca [{places} x ptr], align 64
  %last = sub i64 %samples, 1
  %packed = load ptr, ptr %data
  br label %group
group:
  %start = phi i64 [ 0, %entry ], [ %next, %stored ]
  %going = icmp slt i64 %start, %samples
  br i1 %going, label %lane, label %done
lane:
  %l = phi i64 [ 0, %group ], [ %l_next, %lane_end ]
  %place = add i64 %start, %l
  %beyond = icmp sgt i64 %place, %last
  %sample = select i1 %beyond, i64 %last, i64 %place
  %row = mul i64 %sample, {width}
  br label %entry_loop
entry_loop:
  %j = phi i64 [ 0, %lane ], [ %j_next, %entry_body ]
  %more = icmp slt i64 %j, {width}
  br i1 %more, label %entry_body, label %pointers
entry_body:
  %from_index = add i64 %row, %j
  %from = getelementptr double, ptr %packed, i64 %from_index
  %value = load double, ptr %from
  %to_row = mul i64 %j, {lanes}
  %to_index = add i64 %to_row, %l
  %to = getelementptr double, ptr %in, i64 %to_index
  store double %value, ptr %to
  %j_next = add i64 %j, 1
  br label %entry_loop
pointers:
{pointers}
  br label %lane_end
lane_end:
  %l_next = add i64 %l, 1
  %all = icmp sge i64 %l_next, {lanes}
  br i1 %all, label %run, label %lane
run:
  call void @{name}.loop(ptr %in, ptr %given, ptr %big, i64 %most)
  br label %store_lane
store_lane:
  %s = phi i64 [ 0, %run ], [ %s_next, %store_end ]
  %goal = add i64 %start, %s
  %inside = icmp slt i64 %goal, %samples
  br i1 %inside, label %store_row, label %stored
store_row:
  %k = phi i64 [ 0, %store_lane ], [ %k_next, %store_row ]
  %give_row = mul i64 %k, {lanes}
  %give_index = add i64 %give_row, %s
  %give = getelementptr double, ptr %given, i64 %give_index
  %gift = load double, ptr %give
  %goal_row = mul i64 %goal, {height}
  %goal_index = add i64 %goal_row, %k
  %goal_place = getelementptr double, ptr %out, i64 %goal_index
  store double %gift, ptr %goal_place
  %k_next = add i64 %k, 1
  %row_done = icmp sge i64 %k_next, {height}
  br i1 %row_done, label %store_end, label %store_row
store_end:
  %s_next = add i64 %s, 1
  %lanes_done = icmp sge i64 %s_next, {lanes}
  br i1 %lanes_done, label %stored, label %store_lane
stored:
  %next = add i64 %start, {lanes}
  br label %group
done:
  ret void
}}
"""


class Program(NamedTuple):
    """A while loop as two programs: condition over (its constants, state), body over (its
    constants, state).
    """

    condition: ClosedJaxpr
    body: ClosedJaxpr
    condition_constants: int
    body_constants: int


class Kernel(NamedTuple):
    """Compiled code: the name under which XLA knows it, and its address for a direct call."""

    name: str
    address: int


def avals_of(program: Program) -> tuple[list, list]:
    """Shapes and types of (constants of both programs in turn, state)."""
    first, second = program.condition.in_avals[: program.condition_constants], program.body.in_avals
    return [*first, *second[: program.body_constants]], list(second[program.body_constants :])


def in_memory(program: Program) -> list[bool]:
    """For each constant and then each part of the state, whether it is read by index instead of
    being packed.
    """
    constants, state = avals_of(program)
    long = [
        int(np.prod(a.shape)) > LONGEST_IN_REGISTERS and a.dtype == np.float64 for a in constants
    ]
    return [*long, *[False] * len(state)]


def floats_in(avals: Sequence) -> int:
    return sum(int(np.prod(a.shape)) for a in avals)


def text_of(program: Program, lanes: int) -> str:
    """The loop as LLVM code, function `NAME.loop(in, out, big, most)`, and what it calls."""
    writer = Writer(lanes)
    constants, state = avals_of(program)
    position, slot, values = 0, 0, []
    for aval, long in zip([*constants, *state], in_memory(program), strict=True):
        kind = kind_of(aval.dtype)
        if long:
            places = [
                writer.put(f"getelementptr ptr, ptr %big, i64 {slot * lanes + lane}")
                for lane in range(lanes)
            ]
            values.append(
                InMemory(
                    [writer.put(f"load ptr, ptr {place}") for place in places], tuple(aval.shape)
                )
            )
            slot += 1
            continue
        array = array_of(None, tuple(aval.shape))
        for index in np.ndindex(*aval.shape):
            array[index] = _load(writer, position, kind)
            position += 1
        values.append(array)
    c, b = program.condition_constants, program.body_constants
    fixed_condition, fixed_body, first = values[:c], values[c : c + b], values[c + b :]
    kinds = [kind_of(a.dtype) for a in state]
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
    position = 0
    for array, kind in zip(last, kinds, strict=True):
        for value in array.flat:
            _store(writer, position, value, kind)
            position += 1
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


@functools.cache
def interface_version() -> tuple[int, int]:
    """Version of XLA's foreign function interface; `Unsupported` where its structures are not those
    read above.
    """
    header = (Path(jax.ffi.include_dir()) / "xla/ffi/api/c_api.h").read_text()
    plain = re.sub(r"\s+", " ", re.sub(r"//[^\n]*", "", header))
    wanted = (
        "struct XLA_FFI_Buffer { size_t struct_size; XLA_FFI_Extension_Base* extension_start; "
        "XLA_FFI_DataType dtype; "
        "void* data; int64_t rank; int64_t* dims; };",
        "struct XLA_FFI_Args { size_t struct_size; XLA_FFI_Extension_Base* extension_start; "
        "int64_t size; "
        "XLA_FFI_ArgType* types; void** args; };",
        "struct XLA_FFI_Rets { size_t struct_size; XLA_FFI_Extension_Base* extension_start; "
        "int64_t size; "
        "XLA_FFI_RetType* types; void** rets; };",
        "struct XLA_FFI_CallFrame { size_t struct_size; XLA_FFI_Extension_Base* extension_start; "
        "const XLA_FFI_Api* api; "
        "XLA_FFI_ExecutionContext* ctx; XLA_FFI_ExecutionStage stage; XLA_FFI_Args args; "
        "XLA_FFI_Rets rets; ",
        "struct XLA_FFI_Metadata { size_t struct_size; XLA_FFI_Api_Version api_version; "
        "XLA_FFI_Handler_Traits traits; "
        "XLA_FFI_TypeId state_type_id; };",
        "struct XLA_FFI_Metadata_Extension { XLA_FFI_Extension_Base extension_base; "
        "XLA_FFI_Metadata* metadata; };",
    )
    if not all(part in plain for part in wanted):
        raise Unsupported("XLA's foreign function interface of this jaxlib")
    major, minor = (
        int(re.search(rf"#define XLA_FFI_API_{part} (\d+)", header).group(1))
        for part in ("MAJOR", "MINOR")
    )
    return major, minor


def check(program: Program, kernel: Kernel) -> None:
    """One turn of the kernel on random numbers against NumPy. Raises `Unsupported` where they
    differ.
    """
    constants, state = avals_of(program)
    avals = [*constants, *state]
    samples = checking.random_values(avals)
    kept = in_memory(program)
    rows = [
        np.concatenate([v.ravel().astype(float) for v, k in zip(s, kept, strict=True) if not k])
        for s in samples
    ]
    packed = np.ascontiguousarray(rows)
    big = [np.ascontiguousarray([s[i] for s in samples]) for i, k in enumerate(kept) if k]
    out = np.zeros((len(samples), floats_in(state)))
    data = (ctypes.c_void_p * (1 + len(big)))(packed.ctypes.data, *[b.ctypes.data for b in big])
    call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)(
        kernel.address
    )
    call(ctypes.cast(data, ctypes.c_void_p), out.ctypes.data, len(samples), 1)

    turn_of = checking.evaluator(program.body)

    def by_numpy(sample):
        turn = turn_of(*sample[program.condition_constants :])
        return np.concatenate([np.ravel(v).astype(float) for v in turn])

    with jax.ensure_compile_time_eval(), np.errstate(all="ignore"):
        wanted, changed = (
            np.array([by_numpy(f(s)) for s in samples]) for f in (lambda s: s, checking.nudged)
        )
    first = np.array(
        [np.concatenate([np.ravel(v).astype(float) for v in s[len(constants) :]]) for s in samples]
    )
    if not checking.agree(out, wanted, changed, first):
        raise Unsupported("a loop whose kernel does not agree with NumPy")


_ENGINES: dict[str, tuple[Any, Kernel]] = {}


def build(program: Program, lanes: int) -> Kernel:
    """Compile, register with XLA, and check. Raises `Unsupported`."""
    import llvmlite.binding as llvm

    major, minor = interface_version()
    text = text_of(program, lanes)
    constants, state = avals_of(program)
    avals = list(zip([*constants, *state], in_memory(program), strict=True))
    big = [a for a, long in avals if long]
    name = (
        "jaxclear_"
        + hashlib.sha256(f"{text}{lanes}{[a.shape for a in big]}".encode()).hexdigest()[:24]
    )
    if name in _ENGINES:
        return _ENGINES[name][1]
    width, height = floats_in([a for a, long in avals if not long]), floats_in(state)
    loads, pointers = [], []
    for i in range(1 + len(big)):
        loads += [
            f"  %a{i} = getelementptr ptr, ptr %arguments, i64 {i}",
            f"  %b{i} = load ptr, ptr %a{i}",
            f"  %c{i} = getelementptr i8, ptr %b{i}, i64 24",
            f"  %d{i} = load ptr, ptr %c{i}",
            f"  %e{i} = getelementptr ptr, ptr %data, i64 {i}",
            f"  store ptr %d{i}, ptr %e{i}",
        ]
    for i, aval in enumerate(big):
        pointers += [
            f"  %f{i} = getelementptr ptr, ptr %data, i64 {i + 1}",
            f"  %g{i} = load ptr, ptr %f{i}",
            f"  %h{i} = mul i64 %sample, {int(np.prod(aval.shape))}",
            f"  %i{i} = getelementptr double, ptr %g{i}, i64 %h{i}",
            f"  %j{i} = add i64 %l, {i * lanes}",
            f"  %k{i} = getelementptr ptr, ptr %big, i64 %j{i}",
            f"  store ptr %i{i}, ptr %k{i}",
        ]
    handler = HANDLER.format(
        name=name, major=major, minor=minor, arrays=1 + len(big), loads="\n".join(loads)
    )
    samples = SAMPLES.format(
        name=name,
        inputs=max(width * lanes, 1),
        outputs=max(height * lanes, 1),
        places=max(len(big) * lanes, 1),
        width=width,
        height=height,
        lanes=lanes,
        pointers="\n".join(pointers),
    )
    module = llvm.parse_assembly(text.replace("@NAME", f"@{name}") + samples + handler)
    machine = _machine()
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    passes = llvm.create_pass_builder(machine, options)
    passes.getModulePassManager().run(module, passes)
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    kernel = Kernel(name, engine.get_function_address(f"{name}.samples"))
    check(program, kernel)
    _register(name, engine.get_function_address(name))
    _ENGINES[name] = (engine, kernel)
    return kernel


def _register(name: str, address: int) -> None:
    capsule = ctypes.pythonapi.PyCapsule_New
    capsule.restype, capsule.argtypes = (
        ctypes.py_object,
        [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p],
    )
    jax.ffi.register_ffi_target(name, capsule(address, None, None), platform="cpu", api_version=1)
