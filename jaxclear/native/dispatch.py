"""How XLA calls a kernel: the one function that it knows, which looks a kernel up by its number,
the function that takes XLA's frame, and the loop over samples behind it.

XLA keeps a registered function for ever. Kernels go with their programs, so they are not
registered: a custom call carries a kernel's number, which its text decides, and a table gives the
address that this number has in this process. A number without an address ends the run with an
error of XLA. The table counts the executables of XLA's that call a kernel: XLA creates a state for
each call in an executable that it makes, and deletes it with the executable, which it keeps while
it runs. The memory of a kernel that no program keeps is freed when its count is zero.

A custom call receives one frame that points to its arrays. `HANDLER` reads the packed rows, the
arrays kept in memory and the place of the result out of it; `SAMPLES` brings `lanes` samples at a
time into the order in which the loop reads them, and its results back. The offsets are those of
XLA's foreign function interface, version by version: `interface_version` looks at the header that
comes with jaxlib, and refuses another layout. The LLVM code stands in the folder `llvm`.
"""

import ctypes
import functools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax

from jaxclear.native import object_code
from jaxclear.native.writer import Unsupported

TARGET = "jaxclear_loop"
# Rows of the table, a power of two. A number keeps its row for ever: XLA keeps some 0.7 MB of each
# program that is dropped, so that memory ends before the rows do.
ROWS = 1 << 16


class Row(ctypes.Structure):
    """A row of the table: a kernel's number (0: none yet), where its code is (0: nowhere) and how
    many executables call it."""

    _fields_ = [(name, ctypes.c_int64) for name in ("number", "address", "executables")]


def _allocate_table() -> Any:
    """Memory that is never freed: XLA deletes executables when Python has ended."""
    allocate = ctypes.pythonapi.PyMem_RawCalloc
    allocate.restype, allocate.argtypes = ctypes.c_void_p, [ctypes.c_size_t, ctypes.c_size_t]
    return (Row * ROWS).from_address(allocate(ROWS, ctypes.sizeof(Row)))


TABLE = _allocate_table()
DROPPED = b"jaxclear: the kernel of this program has been dropped; compile the program again."
# Code of an internal error in XLA's foreign function interface.
INTERNAL = 13


def read_template(name: str) -> str:
    """LLVM code with places to be filled in, from the file of this name."""
    return (Path(__file__).parent / "llvm" / f"{name}.ll").read_text(encoding="utf-8")


# An internal error of XLA's, with its message.
ERROR = read_template("error").format(internal=INTERNAL)
FUNCTION = read_template("function")


@functools.cache
def register_with_xla() -> Any:
    """Makes the function known to XLA, once; gives the engine that holds it."""
    major, minor = interface_version()
    text = FUNCTION.format(
        name=TARGET,
        major=major,
        minor=minor,
        table=ctypes.addressof(TABLE),
        mask=ROWS - 1,
        length=len(DROPPED) + 1,
        message=DROPPED.decode(),
        error=ERROR,
    )
    engine = object_code.compiled(text)
    state: Any = {
        "type_id": _capsule(engine.get_global_value_address(f"{TARGET}.type")),
        "type_info": _capsule(engine.get_global_value_address(f"{TARGET}.info")),
    }
    jax.ffi.register_ffi_type(TARGET, state, platform="cpu")
    instantiate = _capsule(engine.get_function_address(f"{TARGET}.instantiate"))
    register("cpu", engine, instantiate=instantiate)
    return engine


def register(platform: str, engine: Any, **stages: Any) -> None:
    """Makes the function of an engine known to XLA on a platform, with functions for other
    `stages` than that of a call."""
    functions = {"execute": _capsule(engine.get_function_address(TARGET)), **stages}
    jax.ffi.register_ffi_target(TARGET, functions, platform=platform, api_version=1)


def _capsule(address: int) -> Any:
    make = ctypes.pythonapi.PyCapsule_New
    make.restype, make.argtypes = (
        ctypes.py_object,
        [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p],
    )
    return make(address, None, None)


def row_of_kernel(number: int) -> Row:
    """The row of a number (positive, 63 bits) in the table, from now on if it had none."""
    address = _machine_function("find", ctypes.c_void_p, ctypes.c_int64)(number)
    if not address:
        raise MemoryError(f"jaxclear compiles {ROWS} kernels in one process, and no more.")
    return Row.from_address(address)


def enter_kernel(number: int, address: int) -> None:
    """From now on this number stands for the kernel at an address."""
    row_of_kernel(number).address = address


def remove(number: int, address: int) -> None:
    """The number stands for no kernel any more, if it stood for the one at this address."""
    row = ctypes.addressof(row_of_kernel(number))
    _machine_function("remove", None, ctypes.c_void_p, ctypes.c_int64)(row, address)


def _machine_function(what: str, *types: Any) -> Any:
    """A function of machine code that changes the table in steps that other threads see whole."""
    return ctypes.CFUNCTYPE(*types)(register_with_xla().get_function_address(f"{TARGET}.{what}"))


def size() -> int:
    """Kernels in the table."""
    return sum(row.address != 0 for row in TABLE)


# Offsets are in bytes.
# What XLA's frame holds: the places of arrays and results, and the sizes of the first array.
ARRAYS = read_template("arrays")
HANDLER = read_template("frame")
SAMPLES = read_template("samples")


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
    "_XLA_FFI_API_STRUCT_FIELD(XLA_FFI_Error_Create); "
    "_XLA_FFI_API_STRUCT_FIELD(XLA_FFI_Error_GetMessage); "
    "_XLA_FFI_API_STRUCT_FIELD(XLA_FFI_Error_Destroy); "
    "_XLA_FFI_API_STRUCT_FIELD(XLA_FFI_Handler_Register); "
    "_XLA_FFI_API_STRUCT_FIELD(XLA_FFI_Stream_Get); "
    "_XLA_FFI_API_STRUCT_FIELD(XLA_FFI_Type_Register); "
    "_XLA_FFI_API_STRUCT_FIELD(XLA_FFI_ExecutionContext_Get); "
    "_XLA_FFI_API_STRUCT_FIELD(XLA_FFI_State_Set);",
    "struct XLA_FFI_State_Set_Args { size_t struct_size; "
    "XLA_FFI_Extension_Base* extension_start; XLA_FFI_ExecutionContext* ctx; "
    "XLA_FFI_ExecutionStage stage; XLA_FFI_TypeId* type_id; void* state; };",
    "struct XLA_FFI_TypeId { int64_t type_id; }",
    "struct XLA_FFI_TypeInfo { size_t struct_size; XLA_FFI_Extension_Base* extension_start; "
    "void (*deleter)(void* object); }",
    "struct XLA_FFI_Error_Create_Args { size_t struct_size; "
    "XLA_FFI_Extension_Base* extension_start; const char* message; XLA_FFI_Error_Code errc; };",
    "struct XLA_FFI_Metadata { size_t struct_size; XLA_FFI_Api_Version api_version; "
    "XLA_FFI_Handler_Traits traits; XLA_FFI_TypeId state_type_id; };",
    "struct XLA_FFI_Metadata_Extension { XLA_FFI_Extension_Base extension_base; "
    "XLA_FFI_Metadata* metadata; };",
)
# Structures and functions that later versions call otherwise, and lay out alike.
RENAMED = {
    "XLA_FFI_Error_GetDetails": "XLA_FFI_Error_GetMessage",
    "XLA_FFI_InternalExtension": "XLA_FFI_Extension_Base",
    "XLA_FFI_InvokeContext": "XLA_FFI_ExecutionContext",
}


@functools.cache
def interface_version() -> tuple[int, int]:
    """Version of XLA's foreign function interface; `Unsupported` where its structures are not those
    read above.
    """
    plain = read_interface()
    if not all(part in plain for part in STRUCTURES):
        raise Unsupported("XLA's foreign function interface of this jaxlib")
    parts = [re.search(rf"#define XLA_FFI_API_{part} (\d+)", plain) for part in ("MAJOR", "MINOR")]
    major, minor = (int(match[1]) for match in parts if match)
    return major, minor


def read_interface() -> str:
    """The header of that interface that comes with jaxlib, without comments and line ends, by the
    names used above."""
    header = (Path(jax.ffi.include_dir()) / "xla/ffi/api/c_api.h").read_text()
    plain = re.sub(r"\s+", " ", re.sub(r"//[^\n]*", "", header))
    for now, before in RENAMED.items():
        plain = plain.replace(now, before)
    return plain


def frame_code(
    name: str,
    lanes: int,
    width: int,
    height: int,
    in_memory: Sequence[int],
    tables: Sequence[int] = (),
) -> str:
    """LLVM code of the function that XLA enters, with the loop over samples, for a kernel.

    Args:
        name: of the kernel.
        lanes: samples that the kernel takes at once.
        width, height: floats of a packed row in and out.
        in_memory: numbers of each sample in each array that is read by index; 0: shared by all
            samples.
        tables: numbers of each sample in each array that is written, which follow those in memory.
    """
    loads, pointers = [], []
    read, in_memory = len(in_memory), [*in_memory, *tables]
    for i in range(1 + len(in_memory)):
        buffer_operands = f"%arguments, i64 {i}" if i <= read else f"%results, i64 {i - read}"
        loads += [
            f"  %a{i} = getelementptr ptr, ptr {buffer_operands}",
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
    handler = HANDLER.format(
        name=name, sizes=ARRAYS, arrays=1 + len(in_memory), loads="\n".join(loads)
    )
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


def widest_lanes() -> int:
    """Samples that one vector register of this processor holds, twice over where registers are
    short.
    """
    import llvmlite.binding as llvm

    return 8 if llvm.get_host_cpu_features().get("avx512f") else 4
