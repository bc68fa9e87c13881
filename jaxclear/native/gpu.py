"""Kernels on an NVIDIA GPU: the text of one lane, a thread a sample, called by XLA on its stream.

No device has run this yet, so it is off unless JAXCLEAR_GPU_KERNELS=1 asks for it; nothing of it is
imported otherwise. A kernel that is new to a machine takes one turn on the device, on random
numbers, through XLA as later calls go, beside the same turn by the processor's kernel; where they
differ by more than last digits explain, where the driver does not take the text, or a part of this
is missing, `Unsupported` says so, and XLA runs the loop.

`gpu_threads` writes the thread's text, `gpu_ptx` makes PTX of it, `gpu_driver` loads that, and
`gpu_call` is how XLA reaches it. Kernels stay loaded until the process ends.
"""

import hashlib
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.ground import cache_folder
from jaxclear.native import check, dispatch, gpu_call, gpu_driver, gpu_ptx, gpu_threads, object_code
from jaxclear.native import kernel as kernels
from jaxclear.native.program import Program, avals_of
from jaxclear.native.writer import Unsupported

# What a call of a kernel by its number gives: `(values, program, rank, number)` to all results.
Call = Callable[..., list]
# Lines beyond which a driver takes minutes to compile a kernel: of 31 000 ptxas makes code in 23 s.
MOST_LINES = 60_000


class GpuKernel(NamedTuple):
    """A kernel that programs on a GPU may call: its number, the function by which XLA does, and
    what the driver made of it on each device."""

    number: int
    handler: Any
    loaded: list[gpu_driver.Loaded]


_BUILDING = threading.RLock()
_KERNELS: dict[int, GpuKernel] = {}


def is_ready() -> bool:
    """Whether this process has a GPU, with a driver, that kernels are written for."""
    try:
        gpu_ptx.processor_of(gpu_driver.driver().capability)
        gpu_call.register_with_xla()
    except (Unsupported, ImportError):
        return False
    return True


def list_kernels() -> list[GpuKernel]:
    """The kernels of this process, those that took one turn for a comparison among them."""
    return list(_KERNELS.values())


def build(program: Program, call: Call) -> GpuKernel:
    """Compile, compare where the machine does not know it yet, and make known. Raises
    `Unsupported`."""
    gpu_call.register_with_xla()
    text = gpu_threads.text_of(program)
    if text.count("\n") > MOST_LINES:
        raise Unsupported("a program this long on a GPU")
    with _BUILDING:
        cached = _KERNELS.get(_number(text, program))
        if cached is None:
            key = _key_of_ptx(text, program)
            ptx = cache_folder.read(cache_folder.KERNEL, key)
            if ptx is None or check.is_check_enabled():
                _compare(program, call)
                cached = _load_kernel(text, program)
                # What has passed is cached.
                cache_folder.write(cache_folder.KERNEL, key, _compile_ptx(text, program).encode())
            else:
                cached = _load_kernel(text, program, ptx.decode())
        return cached


def _compare(program: Program, call: Call) -> None:
    """Raises `Unsupported` where a turn on the device is not what it is on the processor."""
    one = _load_kernel(gpu_threads.text_of(program, checked=True), program)

    def turn(samples):
        inputs = [
            np.asarray(samples[0][i]) if i in program.shared else np.stack([s[i] for s in samples])
            for i in range(len(samples[0]))
        ]
        with jax.ensure_compile_time_eval():
            run = lambda *values: call(*values, program=program, rank=1, number=one.number)
            outputs = [np.asarray(each, float) for each in jax.jit(run)(*map(jnp.asarray, inputs))]
        state = len(avals_of(program)[1])
        flat = lambda each: each.reshape(len(samples), -1)
        tables = outputs[state:]
        parts = [*outputs[:state], *(each[:, -1] for each in tables), *(t[:, 0] for t in tables)]
        return np.hstack(list(map(flat, parts)))

    check.check(program, turn, kernels.turn_of(program, 1), "the processor's, on a GPU")


def _load_kernel(text: str, program: Program, ptx: str | None = None) -> GpuKernel:
    """The kernel of a text, loaded, and in the table under its number."""
    number = _number(text, program)
    if number not in _KERNELS:
        name, driver = _name_of_kernel(number), gpu_driver.driver()
        loaded = driver.load(_compile_ptx(text, program) if ptx is None else ptx, name)
        arrays = gpu_threads.arrays_of(program)
        places = driver.address("cuStreamGetCtx"), driver.address("cuLaunchKernel")
        counts = 1 + len(arrays.read), 1 + len(arrays.written)
        engine = object_code.compiled(gpu_call.handler_text(name, loaded, *counts, places))
        dispatch.enter_kernel(number, engine.get_function_address(name))
        _KERNELS[number] = GpuKernel(number, engine, loaded)
    return _KERNELS[number]


def _compile_ptx(text: str, program: Program) -> str:
    name = _name_of_kernel(_number(text, program))
    processor = gpu_ptx.processor_of(gpu_driver.driver().capability)
    return gpu_ptx.ptx_of(text.replace("@NAME", f"@{name}"), processor)


def _number(text: str, program: Program) -> int:
    """What stands for a kernel in programs: a whole number of 63 bits, not one of the
    processor's."""
    form = f"gpu {text} {gpu_threads.arrays_of(program)}"
    return max(int(hashlib.sha256(form.encode()).hexdigest()[:16], 16) >> 1, 1)


def _name_of_kernel(number: int) -> str:
    return f"jaxclear_gpu_{number:x}"


def _key_of_ptx(text: str, program: Program) -> str:
    """Under which PTX is kept that has passed its comparison, on this device by this driver."""
    driver, devices = gpu_driver.driver(), [each.device_kind for each in jax.local_devices()]
    about = f"{driver.version} {driver.capability} {devices} {gpu_ptx.find_libdevice()}"
    return cache_folder.key_of(text, str(_number(text, program)), about, object_code.processor())
