"""How XLA calls a kernel on a GPU: a function of this processor that hands it to the driver.

As on the processor, XLA knows one function, which finds the kernel's own by its number
(`dispatch`). That one reads the arrays' places, which are on the device, out of XLA's frame, asks
XLA for its stream, takes the kernel loaded in the context of that stream, and launches as many
threads as there are samples; it waits for nothing. Arrays are (numbers of a sample, samples), so
the samples are the last size of the first one.
"""

import functools
from collections.abc import Sequence

from jaxclear.native import dispatch
from jaxclear.native.gpu_driver import Loaded
from jaxclear.native.gpu_threads import BLOCK
from jaxclear.native.writer import Unsupported

# How XLA's interface goes on behind what `dispatch` reads.
STRUCTURES = (
    "struct XLA_FFI_Stream_Get_Args { size_t struct_size; "
    "XLA_FFI_Extension_Base* extension_start; XLA_FFI_ExecutionContext* ctx; void* stream; };",
)
FAILED = "jaxclear: the driver of the GPU has not launched a kernel."
ELSEWHERE = "jaxclear: a kernel was called on a GPU that was not there when it was compiled."

HANDLER = dispatch.read_template("gpu_frame")


@functools.cache
def register_with_xla() -> None:
    """Makes the function that finds kernels known to XLA on CUDA. Raises `Unsupported` for another
    interface of XLA."""
    if not all(part in dispatch.read_interface() for part in STRUCTURES):
        raise Unsupported("XLA's foreign function interface of this jaxlib, on a GPU")
    dispatch.register("CUDA", dispatch.register_with_xla())


def handler_text(
    name: str, loaded: Sequence[Loaded], read: int, written: int, places: tuple[int, int]
) -> str:
    """LLVM code of the host function by which XLA launches a kernel on the GPU.

    Args:
        name: of the kernel.
        loaded: the kernel on each device.
        read, written: numbers of arrays in and out.
        places: addresses of two driver functions in this process: which context a stream has,
            and the
            launch.
    """
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
        context_of=places[0],
        functions="\n".join(functions),
        devices=len(loaded),
        parameters="\n".join(parameters),
        before=BLOCK - 1,
        block=BLOCK,
        launch=places[1],
    )
