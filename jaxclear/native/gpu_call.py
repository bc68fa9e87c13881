"""How XLA calls a kernel on a GPU: a function of this processor that hands it to the driver.

As on the processor, XLA knows one function, which finds the kernel's own by its number
(`dispatch`). That one reads the arrays' places, which are on the device, out of XLA's frame, asks
XLA for its stream, takes the kernel loaded in the context of that stream, and launches as many
threads as there are samples; it waits for nothing. Arrays are (numbers of a sample, samples), so
the samples are the last size of the first one.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

from jaxclear.native import dispatch
from jaxclear.native.gpu_driver import Loaded
from jaxclear.native.gpu_threads import BLOCK
from jaxclear.native.writer import Unsupported

# How XLA's interface goes on behind what `dispatch` reads.
STRUCTURES = (
    "_XLA_FFI_API_STRUCT_FIELD(XLA_FFI_Error_Create); "
    "_XLA_FFI_API_STRUCT_FIELD(XLA_FFI_Error_GetMessage); "
    "_XLA_FFI_API_STRUCT_FIELD(XLA_FFI_Error_Destroy); "
    "_XLA_FFI_API_STRUCT_FIELD(XLA_FFI_Handler_Register); "
    "_XLA_FFI_API_STRUCT_FIELD(XLA_FFI_Stream_Get);",
    "struct XLA_FFI_Stream_Get_Args { size_t struct_size; "
    "XLA_FFI_Extension_Base* extension_start; XLA_FFI_ExecutionContext* ctx; void* stream; };",
)
FAILED = "jaxclear: the driver of the GPU has not launched a kernel."
ELSEWHERE = "jaxclear: a kernel was called on a GPU that was not there when it was compiled."

HANDLER = """{error}
@failed = internal constant [{failed_length} x i8] c"{failed}\\00"
@elsewhere = internal constant [{elsewhere_length} x i8] c"{elsewhere}\\00"
define ptr @{name}(ptr %frame) {{
entry:
  %asked = alloca {{ i64, ptr, ptr, ptr }}
  %context_place = alloca ptr
  %samples_place = alloca i64
  %given = alloca [{count} x ptr]
{sizes}
  %last = sub i64 %rank, 1
  %size_place = getelementptr i64, ptr %sizes, i64 %last
  %samples = load i64, ptr %size_place
  %some = icmp sgt i64 %samples, 0
  br i1 %some, label %ask, label %done
ask:
  %ctx_place = getelementptr i8, ptr %frame, i64 24
  %ctx = load ptr, ptr %ctx_place
  %filled = insertvalue {{ i64, ptr, ptr, ptr }} {{ i64 32, ptr null, ptr null, ptr null }},
    ptr %ctx, 2
  store {{ i64, ptr, ptr, ptr }} %filled, ptr %asked
  %interface_place = getelementptr i8, ptr %frame, i64 16
  %interface = load ptr, ptr %interface_place
  %get_place = getelementptr i8, ptr %interface, i64 80
  %get = load ptr, ptr %get_place
  %error = call ptr %get(ptr %asked)
  %heard = icmp eq ptr %error, null
  br i1 %heard, label %find, label %passed_on
passed_on:
  ret ptr %error
find:
  %stream_place = getelementptr i8, ptr %asked, i64 24
  %stream = load ptr, ptr %stream_place
  %context_of = inttoptr i64 {context_of} to ptr
  %said = call i32 %context_of(ptr %stream, ptr %context_place)
  %told = icmp eq i32 %said, 0
  br i1 %told, label %choose, label %wrong
choose:
  %context = load i64, ptr %context_place
{functions}
  %there = icmp ne i64 %function.{devices}, 0
  br i1 %there, label %start, label %strange
start:
  store i64 %samples, ptr %samples_place
  store ptr %samples_place, ptr %given
{parameters}
  %filling = add i64 %samples, {before}
  %blocks = udiv i64 %filling, {block}
  %grid = trunc i64 %blocks to i32
  %function = inttoptr i64 %function.{devices} to ptr
  %launch = inttoptr i64 {launch} to ptr
  %code = call i32 %launch(ptr %function, i32 %grid, i32 1, i32 1, i32 {block}, i32 1, i32 1,
    i32 0, ptr %stream, ptr %given, ptr null)
  %launched = icmp eq i32 %code, 0
  br i1 %launched, label %done, label %wrong
done:
  ret ptr null
wrong:
  %of_driver = call ptr @error(ptr %frame, ptr @failed)
  ret ptr %of_driver
strange:
  %of_device = call ptr @error(ptr %frame, ptr @elsewhere)
  ret ptr %of_device
}}
"""


@functools.cache
def known_to_xla() -> None:
    """Makes the function that finds kernels known to XLA on CUDA. Raises `Unsupported` for another
    interface of XLA."""
    if not all(part in dispatch.interface() for part in STRUCTURES):
        raise Unsupported("XLA's foreign function interface of this jaxlib, on a GPU")
    dispatch.register("CUDA", dispatch.known_to_xla())


class Places(NamedTuple):
    """Where two functions of the driver are in this process: what tells the context of a stream,
    and what launches a kernel."""

    context_of: int
    launch: int


def handler_text(
    name: str, loaded: Sequence[Loaded], read: int, written: int, places: Places
) -> str:
    """LLVM code of the function that XLA enters for a kernel, loaded on these devices, of so many
    arrays in and out."""
    functions = ["  %function.0 = add i64 0, 0"]
    for k, each in enumerate(loaded):
        functions += [
            f"  %here.{k} = icmp eq i64 %context, {each.context}",
            f"  %function.{k + 1} = select i1 %here.{k}, i64 {each.function}, i64 %function.{k}",
        ]
    parameters = []
    # In the order of the kernel's arguments: packed rows, in and out, then all other arrays.
    arguments = [("arguments", k) for k in range(read)]
    results = [("results", k) for k in range(written)]
    order = [arguments[0], results[0], *arguments[1:], *results[1:]]
    for k, (of, position) in enumerate(order, 1):
        parameters += [
            f"  %a{k} = getelementptr ptr, ptr %{of}, i64 {position}",
            f"  %b{k} = load ptr, ptr %a{k}",
            # The kernel's argument is what stands there: the array's place on the device.
            f"  %c{k} = getelementptr i8, ptr %b{k}, i64 24",
            f"  %d{k} = getelementptr ptr, ptr %given, i64 {k}",
            f"  store ptr %c{k}, ptr %d{k}",
        ]
    return HANDLER.format(
        name=name,
        failed=FAILED,
        failed_length=len(FAILED) + 1,
        elsewhere=ELSEWHERE,
        elsewhere_length=len(ELSEWHERE) + 1,
        error=dispatch.ERROR,
        sizes=dispatch.ARRAYS,
        count=1 + len(order),
        context_of=places.context_of,
        functions="\n".join(functions),
        devices=len(loaded),
        parameters="\n".join(parameters),
        before=BLOCK - 1,
        block=BLOCK,
        launch=places.launch,
    )
