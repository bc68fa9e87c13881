"""A GPU in the place of the driver's: it runs a kernel's threads one after the other on this
processor, and holds the kernel that they stand in for beside them, on the same numbers.

What a device alone can tell stays open (whether its driver takes the PTX, last digits of libdevice,
speed); the thread's text, how arrays are laid out, XLA's call, the comparison before a kernel is
used, and the sentences where something is refused are those that a device would see."""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from jax.interpreters import mlir

from jaxclear.native import (
    dispatch,
    gpu,
    gpu_call,
    gpu_driver,
    gpu_ptx,
    gpu_threads,
    loop,
    object_code,
)
from jaxclear.native import kernel as kernels
from jaxclear.native.stopping import SYMBOL

CONTEXT = 77
PLACE, WORD, CODE = ctypes.c_void_p, ctypes.c_uint, ctypes.c_int
# How XLA's own answer, that a processor has no stream, is passed over.
ASKED, PASSED_OVER = "call ptr %get(ptr %asked)", "getelementptr i8, ptr null, i64 0"


class ImaginedGpu:
    """`launched`: kernels so far; `differing`: those whose arrays were not bit for bit what the
    processor's kernel of one lane makes of the same ones; `off`: what each number that a kernel
    leaves is multiplied by."""

    version, capability = 12040, (9, 0)

    def __init__(self):
        self.launched, self.differing, self.off, self.texts = 0, [], 1.0, {}
        self._kernels = []
        context = ctypes.CFUNCTYPE(CODE, PLACE, PLACE)(self._context_of)
        launch = ctypes.CFUNCTYPE(CODE, PLACE, *[WORD] * 7, *[PLACE] * 3)(self._launch)
        self._functions = {"cuStreamGetCtx": context, "cuLaunchKernel": launch}

    def address(self, name):
        return ctypes.cast(self._functions[name], PLACE).value

    def load(self, ptx, name):
        engine = object_code.compiled(_to_the_bit(f"@{SYMBOL} = external global i64\n{ptx}"))
        program, checked = self.texts[ptx.replace(f"@{name}", "@NAME")]
        own, _, text = kernels._assembled(program, 1, checked)
        beside = object_code.compiled(_to_the_bit(text))
        thread = engine.get_function_address(name)
        samples = beside.get_function_address(f"{own}.samples")
        self._kernels.append((engine, beside, thread, samples, gpu_threads.arrays_of(program)))
        return [gpu_driver.Loaded(CONTEXT, len(self._kernels), 255, 0)]

    def _context_of(self, _, place):
        ctypes.c_uint64.from_address(place).value = CONTEXT
        return 0

    def _launch(self, function, blocks, _1, _2, threads, _3, _4, _5, _6, given, _7):
        _, _, thread, beside, arrays = self._kernels[function - 1]
        word = lambda place, k=0: ctypes.c_uint64.from_address(place + 8 * k).value
        count = 3 + len(arrays.read) + len(arrays.written)
        samples, *places = [word(word(given, k)) for k in range(count)]
        assert 0 <= blocks * threads - samples < threads == gpu_threads.BLOCK
        sizes = [arrays.width, arrays.height, *arrays.read, *arrays.written]
        call = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_int64, *[PLACE] * len(places))
        views = [_seen(*pair, samples) for pair in zip(places, sizes, strict=True)]
        packed, found, *others = views
        read, written = others[: len(arrays.read)], others[len(arrays.read) :]
        # What a single turn leaves alone is alike too.
        for each in (found, *written):
            each[...] = 0.0
        for i in range(samples):
            call(thread)(i, samples, *places)
        # The processor's kernel wants each sample's numbers together.
        together = lambda each: each if isinstance(each, int) else np.ascontiguousarray(each.T)
        out, tables = np.zeros((samples, arrays.height)), [np.zeros(w.T.shape) for w in written]
        data = [*map(together, (packed, *read)), *tables]
        starts = [each if isinstance(each, int) else each.ctypes.data for each in data]
        kernel = ctypes.CFUNCTYPE(None, PLACE, PLACE, ctypes.c_int64)(beside)
        kernel((PLACE * len(starts))(*starts), out.ctypes.data, samples)
        for own, expected in zip((found, *written), (out, *tables), strict=True):
            if not _same_bits(own.T, expected):
                self.differing.append(function)
            own *= self.off
        self.launched += 1
        return 0


def _to_the_bit(text):
    """Of two products in a sum LLVM takes either into one rounding with it, as code around them
    has it; here it takes neither."""
    return text.replace(" contract ", " ")


def _same_bits(one, other):
    """Of a nan no bits are asked: they hang on the order of its operands."""
    bits = lambda each: np.where(np.isnan(each), np.nan, each).view(np.int64)
    return np.array_equal(bits(one), bits(other))


def _seen(place, size, samples):
    """An array of samples by its place; of what all share, the place."""
    if size == 0:
        return place
    numbers = (ctypes.c_double * (size * samples)).from_address(place)
    return np.ctypeslib.as_array(numbers).reshape(size, samples)


@contextmanager
def imagined(monkeypatch) -> Iterator[ImaginedGpu]:
    """Loops of programs that are compiled within become kernels of an imagined GPU."""
    device, text_of = ImaginedGpu(), gpu_threads.text_of

    def watched(program, checked=False, on_host=True):
        text = text_of(program, checked, on_host)
        device.texts[text] = program, checked
        return text

    monkeypatch.setenv(loop.ON_GPU, "1")
    monkeypatch.setattr(gpu_driver, "driver", lambda: device)
    monkeypatch.setattr(gpu_threads, "text_of", watched)
    monkeypatch.setattr(gpu_ptx, "ptx_of", lambda text, _: text)
    monkeypatch.setattr(gpu_call, "register_with_xla", dispatch.register_with_xla)
    assert ASKED in gpu_call.HANDLER
    monkeypatch.setattr(gpu_call, "HANDLER", gpu_call.HANDLER.replace(ASKED, PASSED_OVER))
    monkeypatch.setattr(gpu, "_KERNELS", {})
    mlir.register_lowering(loop.loop_p, loop._lower_on_cuda, platform="cpu")
    try:
        yield device
    finally:
        mlir.register_lowering(loop.loop_p, loop._lower_on_cpu, platform="cpu")
