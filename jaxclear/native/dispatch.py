"""How XLA calls a kernel: the one function that it knows, which looks a kernel up by its number,
the function that takes XLA's frame, and the loop over samples behind it.

XLA keeps a registered function for ever. Kernels go with their programs, so they are not
registered: a custom call carries a kernel's number, which its text decides, and a table gives the
address that this number has in this process. A number that is not in the table ends the run with an
error of XLA. Calls under way are counted: the memory of a kernel is freed when there are none.

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
# Entries of the table, a power of two; open addressing wants it half empty.
PLACES = 1 << 14
# Pairs (number, address); a number stays when its kernel has gone, with address 0, until another
# kernel takes its place.
TABLE = (ctypes.c_int64 * (2 * PLACES))()
# Calls under way of the kernels at each place.
CALLS = (ctypes.c_int64 * PLACES)()
# The number of a place while another kernel takes it.
CHANGING = -1
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
        calls=ctypes.addressof(CALLS),
        changing=CHANGING,
        mask=PLACES - 1,
        length=len(DROPPED) + 1,
        message=DROPPED.decode(),
        error=ERROR,
    )
    engine = object_code.compiled(text)
    register("cpu", engine)
    return engine


def register(platform: str, engine: Any) -> None:
    """Makes the function of an engine known to XLA on a platform."""
    capsule = ctypes.pythonapi.PyCapsule_New
    capsule.restype, capsule.argtypes = (
        ctypes.py_object,
        [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p],
    )
    function_capsule = capsule(engine.get_function_address(TARGET), None, None)
    jax.ffi.register_ffi_target(TARGET, function_capsule, platform=platform, api_version=1)


def _place(number: int) -> int:
    """Where a number stands in the table, or else the first place that is free for it."""
    place, free = number % PLACES, None
    for _ in range(PLACES):
        stored_number, address = TABLE[2 * place], TABLE[2 * place + 1]
        if stored_number == number:
            return place
        if free is None and address == 0:
            free = place
        if stored_number == 0:
            break
        place = (place + 1) % PLACES
    if free is None:
        raise MemoryError(f"jaxclear keeps {PLACES} kernels at once, and these are in use.")
    return free


def enter_kernel(number: int, address: int) -> None:
    """From now on this number (positive, 63 bits) stands for the kernel at an address."""
    # The number last, and nobody's before: a call in another thread may be looking here.
    _atomic_function("enter", None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)(
        _slot_address(_place(number)), number, address
    )


def remove(number: int, address: int) -> int:
    """The number stands for no kernel any more, if it stood for the one at this address. Gives the
    place at which calls of it that are under way are counted."""
    place = _place(number)
    if (TABLE[2 * place], TABLE[2 * place + 1]) == (number, address):
        _atomic_function("leave", ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p)(
            _slot_address(place), ctypes.addressof(CALLS) + 8 * place
        )
    return place


def is_in_use(place: int) -> bool:
    """Whether a kernel is being called at a place of the table."""
    return CALLS[place] > 0


def _slot_address(place: int) -> int:
    return ctypes.addressof(TABLE) + 16 * place


def _atomic_function(what: str, *types: Any) -> Any:
    """A function of machine code that changes the table in an order that other threads see too."""
    return ctypes.CFUNCTYPE(*types)(register_with_xla().get_function_address(f"{TARGET}.{what}"))


def size() -> int:
    """Kernels in the table."""
    return sum(address != 0 for address in TABLE[1::2])


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
