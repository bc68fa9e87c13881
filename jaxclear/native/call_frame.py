"""How a kernel is called: the function that takes XLA's frame, and the loop over samples behind it.

A custom call receives one frame that points to its arrays. `HANDLER` reads the packed rows, the
arrays kept in memory and the place of the result out of it; `SAMPLES` brings `lanes` samples at a
time into the order in which the loop reads them, and its results back. The offsets are those of
XLA's foreign function interface, version by version: `interface_version` looks at the header that
comes with jaxlib, and refuses another layout.
"""

import functools
import re
from collections.abc import Sequence
from pathlib import Path

import jax

from jaxclear.native.writer import Unsupported

# Offsets are in bytes.
HANDLER = """
define ptr @{name}(ptr %frame) {{
entry:
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
  %axis = phi i64 [ 0, %entry ], [ %next_axis, %multiply ]
  %samples = phi i64 [ 1, %entry ], [ %more, %multiply ]
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


# The structures whose offsets are used above, as the header must declare them.
STRUCTURES = (
    "struct XLA_FFI_Buffer { size_t struct_size; XLA_FFI_Extension_Base* extension_start; "
    "XLA_FFI_DataType dtype; void* data; int64_t rank; int64_t* dims; };",
    "struct XLA_FFI_Args { size_t struct_size; XLA_FFI_Extension_Base* extension_start; "
    "int64_t size; XLA_FFI_ArgType* types; void** args; };",
    "struct XLA_FFI_Rets { size_t struct_size; XLA_FFI_Extension_Base* extension_start; "
    "int64_t size; XLA_FFI_RetType* types; void** rets; };",
    "struct XLA_FFI_CallFrame { size_t struct_size; XLA_FFI_Extension_Base* extension_start; "
    "const XLA_FFI_Api* api; XLA_FFI_ExecutionContext* ctx; XLA_FFI_ExecutionStage stage; "
    "XLA_FFI_Args args; XLA_FFI_Rets rets; XLA_FFI_Attrs attrs; ",
    "struct XLA_FFI_Attrs { size_t struct_size; XLA_FFI_Extension_Base* extension_start; "
    "int64_t size; XLA_FFI_AttrType* types; XLA_FFI_ByteSpan** names; void** attrs; };",
    "struct XLA_FFI_Scalar { XLA_FFI_DataType dtype; void* value; }",
    "struct XLA_FFI_Api { size_t struct_size; XLA_FFI_Extension_Base* extension_start; "
    "XLA_FFI_Api_Version api_version; const XLA_FFI_InternalApi* internal_api; "
    "_XLA_FFI_API_STRUCT_FIELD(XLA_FFI_Error_Create);",
    "struct XLA_FFI_Error_Create_Args { size_t struct_size; "
    "XLA_FFI_Extension_Base* extension_start; const char* message; XLA_FFI_Error_Code errc; };",
    "struct XLA_FFI_Metadata { size_t struct_size; XLA_FFI_Api_Version api_version; "
    "XLA_FFI_Handler_Traits traits; XLA_FFI_TypeId state_type_id; };",
    "struct XLA_FFI_Metadata_Extension { XLA_FFI_Extension_Base extension_base; "
    "XLA_FFI_Metadata* metadata; };",
)
# Structures that later versions call otherwise, and lay out alike.
RENAMED = {
    "XLA_FFI_InternalExtension": "XLA_FFI_Extension_Base",
    "XLA_FFI_InvokeContext": "XLA_FFI_ExecutionContext",
}


@functools.cache
def interface_version() -> tuple[int, int]:
    """Version of XLA's foreign function interface; `Unsupported` where its structures are not those
    read above.
    """
    header = (Path(jax.ffi.include_dir()) / "xla/ffi/api/c_api.h").read_text()
    plain = re.sub(r"\s+", " ", re.sub(r"//[^\n]*", "", header))
    for now, before in RENAMED.items():
        plain = plain.replace(now, before)
    if not all(part in plain for part in STRUCTURES):
        raise Unsupported("XLA's foreign function interface of this jaxlib")
    found = [re.search(rf"#define XLA_FFI_API_{part} (\d+)", header) for part in ("MAJOR", "MINOR")]
    major, minor = (int(match[1]) for match in found if match)
    return major, minor


def text(
    name: str,
    lanes: int,
    width: int,
    height: int,
    in_memory: Sequence[int],
    tables: Sequence[int] = (),
) -> str:
    """LLVM code of the function that XLA enters and of the loop over samples, for a kernel `name`.

    `width`, `height`: floats of a packed row in and out; `in_memory`: numbers that each sample has
    in each of the arrays that are read by index (0: it is the same for all); `tables`: in each of
    those that are written, which stand behind them.
    """
    loads, pointers = [], []
    read, in_memory = len(in_memory), [*in_memory, *tables]
    for i in range(1 + len(in_memory)):
        given = f"%arguments, i64 {i}" if i <= read else f"%results, i64 {i - read}"
        loads += [
            f"  %a{i} = getelementptr ptr, ptr {given}",
            f"  %b{i} = load ptr, ptr %a{i}",
            f"  %c{i} = getelementptr i8, ptr %b{i}, i64 24",
            f"  %d{i} = load ptr, ptr %c{i}",
            f"  %e{i} = getelementptr ptr, ptr %data, i64 {i}",
            f"  store ptr %d{i}, ptr %e{i}",
        ]
    for i, size in enumerate(in_memory):
        pointers += [
            f"  %f{i} = getelementptr ptr, ptr %data, i64 {i + 1}",
            f"  %g{i} = load ptr, ptr %f{i}",
            f"  %h{i} = mul i64 %sample, {size}",
            f"  %i{i} = getelementptr double, ptr %g{i}, i64 %h{i}",
            f"  %j{i} = add i64 %l, {i * lanes}",
            f"  %k{i} = getelementptr ptr, ptr %big, i64 %j{i}",
            f"  store ptr %i{i}, ptr %k{i}",
        ]
    handler = HANDLER.format(name=name, arrays=1 + len(in_memory), loads="\n".join(loads))
    samples = SAMPLES.format(
        name=name,
        inputs=max(width * lanes, 1),
        outputs=max(height * lanes, 1),
        places=max(len(in_memory) * lanes, 1),
        width=width,
        height=height,
        lanes=lanes,
        pointers="\n".join(pointers),
    )
    return samples + handler
