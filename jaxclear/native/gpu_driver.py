"""The driver of NVIDIA's GPUs, its library libcuda by ctypes: PTX compiled, and what became of it.

A kernel is loaded into the context of each GPU that JAX sees in this process: the one that all who
use the device share (the primary one), which XLA works in too. It stays loaded until the process
ends: launches go their own way, and nobody counts them.
"""

import ctypes
import functools
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import jax

from jaxclear.native.writer import Unsupported

LIBRARIES = ("libcuda.so.1", "libcuda.so", "nvcuda.dll")
# Names of the driver's interface (cuda.h): of a device and of a function, what is asked; how the
# driver compiles, what is given.
MAJOR, MINOR = 75, 76
LOCAL_BYTES, REGISTERS = 3, 4
ERROR_LOG, ERROR_LOG_SIZE = 5, 6
PREFER_L1 = 2
LOG_BYTES = 8192
LONGEST_MESSAGE = 300


class Loaded(NamedTuple):
    """A kernel on one device: its context and function, places in the driver's memory, and the
    registers and bytes of local memory of a thread."""

    context: int
    function: int
    registers: int
    local_bytes: int


class Driver:
    """The library, opened, with the GPUs that JAX sees."""

    def __init__(self, library: Any, ordinals: list[int]):
        self.library = library
        self._call_driver("cuInit", 0)
        self.contexts = [self._primary_context(ordinal) for ordinal in ordinals]
        self.capability = min(map(self._compute_capability, map(self._device, ordinals)))
        version = ctypes.c_int()
        self._call_driver("cuDriverGetVersion", ctypes.byref(version))
        self.version = version.value

    def address(self, name: str) -> int:
        """Where a function of the library stands in this process."""
        return ctypes.cast(getattr(self.library, name), ctypes.c_void_p).value or 0

    def load(self, ptx: str, name: str) -> list[Loaded]:
        """The kernel of a name on each device. Raises `Unsupported` where the driver does not take
        its PTX."""
        return [self._load_function(context, ptx, name) for context in self.contexts]

    def _load_function(self, context: int, ptx: str, name: str) -> Loaded:
        module, function = ctypes.c_void_p(), ctypes.c_void_p()
        log = ctypes.create_string_buffer(LOG_BYTES)
        keys = (ctypes.c_int * 2)(ERROR_LOG, ERROR_LOG_SIZE)
        values = (ctypes.c_void_p * 2)(ctypes.addressof(log), LOG_BYTES)
        with self._use_context(context):
            load_arguments = ctypes.byref(module), ctypes.c_char_p(ptx.encode()), 2, keys, values
            self._call_driver("cuModuleLoadDataEx", *load_arguments, log=log)
            self._call_driver("cuModuleGetFunction", ctypes.byref(function), module, name.encode())
            # What a thread puts aside goes through this cache, and blocks share nothing.
            self.library.cuFuncSetCacheConfig(function, PREFER_L1)
            attributes = [self._get_attribute(function, what) for what in (REGISTERS, LOCAL_BYTES)]
        return Loaded(context, function.value or 0, *attributes)

    def _get_attribute(self, function: Any, what: int) -> int:
        value = ctypes.c_int()
        self._call_driver("cuFuncGetAttribute", ctypes.byref(value), what, function)
        return value.value

    def _device(self, ordinal: int) -> int:
        device = ctypes.c_int()
        self._call_driver("cuDeviceGet", ctypes.byref(device), ordinal)
        return device.value

    def _primary_context(self, ordinal: int) -> int:
        context = ctypes.c_void_p()
        self._call_driver("cuDevicePrimaryCtxRetain", ctypes.byref(context), self._device(ordinal))
        return context.value or 0

    def _compute_capability(self, device: int) -> tuple[int, int]:
        capability = ctypes.c_int(), ctypes.c_int()
        for number, what in zip(capability, (MAJOR, MINOR), strict=True):
            self._call_driver("cuDeviceGetAttribute", ctypes.byref(number), what, device)
        return capability[0].value, capability[1].value

    @contextmanager
    def _use_context(self, context: int) -> Iterator[None]:
        """What this thread asks of the driver is asked of a context; then of the one before."""
        self._call_driver("cuCtxPushCurrent_v2", ctypes.c_void_p(context))
        try:
            yield
        finally:
            self.library.cuCtxPopCurrent_v2(ctypes.byref(ctypes.c_void_p()))

    def _call_driver(self, name: str, *call_arguments: Any, log: Any = None) -> None:
        error = getattr(self.library, name)(*call_arguments)
        if error:
            log_text = "" if log is None else " ".join(log.value.decode(errors="replace").split())
            log_text = f" ({log_text[:LONGEST_MESSAGE]})" if log_text else ""
            raise Unsupported(f"a GPU whose driver answers {name} by error {error}{log_text}")


@functools.cache
def driver() -> Driver:
    """The driver of this process. Raises `Unsupported` where there is none."""
    devices = [each for each in jax.local_devices() if each.platform == "gpu"]
    if not devices:
        raise Unsupported("a GPU, of which JAX sees none")
    # JAX numbers the devices of a process as the driver does.
    return Driver(_open_library(), [each.local_hardware_id or 0 for each in devices])


def _open_library() -> Any:
    for name in LIBRARIES:
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    raise Unsupported(f"a GPU without the driver of NVIDIA's ({LIBRARIES[0]})")
