"""Kernels on a GPU, as far as none is needed: each thread's text gives the bits of the processor's
kernel, the whole way from a program of JAX to the launch, by an imagined device; NVIDIA's assembler
takes the PTX, where it is installed; and what is refused is said."""

import ctypes
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from benchmarks.claims.accelerator import assembled, ptxas
from benchmarks.claims.slopes import bouncing
from jaxclear.native import (
    explain,
    gpu_call,
    gpu_driver,
    gpu_ptx,
    gpu_threads,
    loop,
    object_code,
    verdict,
    while_loop,
)
from jaxclear.native.verdicts import KERNELS
from jaxclear.native.writer import Unsupported
from tests.native.imagined_gpu import imagined

RUNGS = {
    "fixed": jc.integrator.FixedStep(2e-5),
    "implicit": jc.integrator.ImplicitStep(1e-4),
    "adaptive": jc.integrator.Adaptive(),
    "Moreau-Jean": jc.integrator.MoreauJean(2e-5),
    "non-colliding": jc.integrator.NonColliding(),
}
GIVEN = {"guide": {"friction": "regularised"}}
# LLVM takes over half a minute for the kernels of the others.
SCENES = ("slider_crank", "guide", "flap", "four_bar")
QUICK = (("slider_crank", "fixed"),)
SAMPLES = 3


def question(mechanism, integrator, duration):
    name = next(n for n, c in mechanism.connections.items() if hasattr(c.joint, "clearance"))
    clearance = jc.Variable(lambda m: m.connections[name].joint.clearance, tolerance=2e-6)
    how = {"integrator": integrator, "duration": duration, "save": 4}
    return jc.Problem(mechanism, jc.response.MeanContactForce(name), {"c": clearance}, **how)


def runs(mechanism, integrator, duration=1e-3):
    """The runs of a few samples, compiled anew."""
    problem = question(mechanism, integrator, duration)
    spread = np.linspace(-1e-6, 1e-6, SAMPLES)[:, None]
    values = jnp.asarray(np.asarray(problem.nominal()) + spread)
    return jax.device_get(
        jax.jit(jax.vmap(lambda value: problem.started(problem.setting(value))[2]))(values)
    )


def scenes_and_rungs():
    for name in SCENES:
        for rung in RUNGS:
            marks = () if (name, rung) in QUICK else pytest.mark.slow
            yield pytest.param(name, rung, marks=marks)


@pytest.mark.parametrize(("name", "rung"), list(scenes_and_rungs()))
def test_threads_give_the_bits_of_the_processors_kernel(name, rung, monkeypatch):
    scene = getattr(jc.scenes, name)(**GIVEN.get(name, {}))
    try:
        question(scene, RUNGS[rung], 1e-3)
    except (ValueError, StopIteration) as refused:
        pytest.skip(str(refused))
    with imagined(monkeypatch) as device:
        found = runs(scene, RUNGS[rung])
    assert found.stats.loops == KERNELS
    assert device.launched and not device.differing


@pytest.mark.slow
@pytest.mark.parametrize("rung", ["fixed", "adaptive"])
def test_threads_give_the_bits_of_slopes(rung, monkeypatch):
    problem = question(bouncing(), RUNGS[rung], 0.03)
    force = lambda value: problem.evaluate(value).responses["response"]
    push = lambda value: jax.jvp(force, (value,), (jnp.ones_like(value),))
    with imagined(monkeypatch) as device:
        spread = np.linspace(-1e-6, 1e-6, SAMPLES)[:, None]
        _, slopes = jax.jit(jax.vmap(push))(np.asarray(problem.nominal()) + spread)
    assert device.launched and not device.differing
    assert np.all(slopes)


def growth(rate):
    """A loop of each sample's own length, its number, and what became of it."""
    step = lambda state: (state[0] + 1, state[1] * (1 + rate) + 1.1 + jnp.sin(state[1]))
    turns, value = while_loop(lambda s: s[1] < 9.0, step, (jnp.asarray(0), rate))
    return turns, value, verdict(value)


RATES = np.array([[0.5, 0.11], [0.13, 0.9], [0.2, 0.7]])


def test_loops_of_a_batch_of_batches_run_through_the_launch(monkeypatch):
    turns, values, _ = jax.jit(jax.vmap(jax.vmap(growth)))(RATES)
    with imagined(monkeypatch) as device:
        found = jax.jit(jax.vmap(jax.vmap(lambda rate: growth(rate))))(RATES)
    assert explain(jnp.max(found[2])) == KERNELS
    np.testing.assert_array_equal(found[0], turns)
    # Products joined to sums there, and not here.
    np.testing.assert_allclose(found[1], values, rtol=1e-14)
    assert device.launched and not device.differing


def told(monkeypatch, **changed):
    """What becomes of a loop on an imagined GPU with these attributes; it gives the same anyway."""
    loop._WARNED.clear()
    with imagined(monkeypatch) as device:
        for name, value in changed.items():
            setattr(device, name, value)
        with pytest.warns(RuntimeWarning, match="runs a time loop through XLA"):
            _, value, number = jax.jit(lambda rate: growth(rate))(0.3)
    assert np.isclose(value, jax.jit(lambda rate: growth(rate))(0.3)[1], rtol=1e-14)
    return explain(number)


def test_a_device_that_computes_otherwise_is_left_to_xla(monkeypatch):
    assert "does not agree with the processor's, on a GPU" in told(monkeypatch, off=1 + 1e-7)


def test_last_digits_of_a_devices_functions_pass(monkeypatch):
    with imagined(monkeypatch) as device:
        device.off = 1 + 4e-16
        assert explain(jax.jit(lambda rate: growth(rate))(0.3)[2]) == KERNELS


def test_a_driver_that_refuses_is_told(monkeypatch):
    def load(ptx, name):
        raise Unsupported("a GPU whose driver answers cuModuleLoadDataEx by error 218")

    assert "cuModuleLoadDataEx by error 218" in told(monkeypatch, load=load)


def test_an_old_gpu_is_told():
    assert gpu_ptx.processor_of((12, 0)) == "sm_80"
    with pytest.raises(Unsupported, match=r"compute capability 6\.1"):
        gpu_ptx.processor_of((6, 1))


def test_a_machine_without_a_gpu_is_told():
    gpu_driver.driver.cache_clear()
    with pytest.raises(Unsupported, match="of which JAX sees none"):
        gpu_driver.driver()


class Library:
    """A driver's library of one GPU: what it was asked, in order; `refuses`: what it answers to
    PTX, and why."""

    def __init__(self, refuses=0, log=b""):
        number, place, text = ctypes.c_int, ctypes.c_void_p, ctypes.c_char_p
        self.asked, self.refuses, self.log = [], refuses, log
        kinds = {
            "cuInit": [number],
            "cuDriverGetVersion": [place],
            "cuDeviceGet": [place, number],
            "cuDevicePrimaryCtxRetain": [place, number],
            "cuDeviceGetAttribute": [place, number, number],
            "cuCtxPushCurrent_v2": [place],
            "cuCtxPopCurrent_v2": [place],
            "cuModuleLoadDataEx": [place, text, number, place, place],
            "cuModuleGetFunction": [place, place, text],
            "cuFuncSetCacheConfig": [place, number],
            "cuFuncGetAttribute": [place, number, place],
        }
        for name, types in kinds.items():
            answer = functools.partial(self._answer, name)
            setattr(self, name, ctypes.CFUNCTYPE(number, *types)(answer))

    def _answer(self, name, *given):
        self.asked.append((name, given))
        if name == "cuModuleLoadDataEx" and self.refuses:
            values = (ctypes.c_void_p * 2).from_address(given[4])
            ctypes.memmove(values[0], self.log, min(len(self.log), values[1]))
            return self.refuses
        found = {
            "cuDriverGetVersion": 12080,
            "cuDeviceGet": 3,
            "cuDeviceGetAttribute": {75: 9, 76: 0}.get(given[1] if len(given) > 1 else None),
            "cuFuncGetAttribute": {4: 208, 3: 40}.get(given[1] if len(given) > 1 else None),
        }
        if name in found:
            ctypes.c_int.from_address(given[0]).value = found[name]
        handles = {"cuDevicePrimaryCtxRetain": 70, "cuModuleLoadDataEx": 80}
        handles["cuModuleGetFunction"] = 90
        if name in handles:
            ctypes.c_void_p.from_address(given[0]).value = handles[name]
        return 0


def test_a_kernel_is_loaded_into_the_context_that_xla_uses():
    library = Library()
    driver = gpu_driver.Driver(library, [0])
    assert (driver.capability, driver.version) == ((9, 0), 12080)
    assert driver.load("the text", "kernel") == [gpu_driver.Loaded(70, 90, 208, 40)]
    names = [name for name, _ in library.asked]
    assert names.index("cuCtxPushCurrent_v2") < names.index("cuModuleLoadDataEx")
    assert names[-1] == "cuCtxPopCurrent_v2"
    loading = dict(library.asked)["cuModuleLoadDataEx"]
    assert loading[1] == b"the text"
    assert dict(library.asked)["cuModuleGetFunction"][1:] == (80, b"kernel")


def test_what_the_driver_says_of_a_text_is_passed_on():
    driver = gpu_driver.Driver(Library(218, b"ptxas error: no such\nthing"), [0])
    with pytest.raises(Unsupported, match=r"by error 218 \(ptxas error: no such thing\)"):
        driver.load("the text", "kernel")
    assert driver.library.asked[-1][0] == "cuCtxPopCurrent_v2"


def test_memory_used_in_a_way_that_is_not_known_is_refused():
    with pytest.raises(Unsupported, match="ptrtoint"):
        gpu_threads._thread(["  %v = ptrtoint ptr %in to i64"], [])
    with pytest.raises(Unsupported, match="not known on a GPU"):
        gpu_threads._thread(["  %v = load double, ptr %of_nobody"], [])
    with pytest.raises(Unsupported, match="factorise"):
        gpu_threads._thread(["  call void @NAME.factorise1(ptr %in)"], [])


def test_what_a_thread_keeps_for_itself_stays_together():
    lines = [
        "  %room = alloca [9 x double], align 64",
        "  %at = getelementptr i32, ptr @NAME.table, i64 %k",
        "  %said = load i32, ptr %at, !invariant.load !0",
        "  %own = getelementptr double, ptr %room, i64 %k",
        "  store double %x, ptr %own, !llvm.access.group !1",
        "  call void @NAME.factorise1(ptr %room, ptr %room)",
    ]
    assert gpu_threads._thread(lines, []) == lines
    apart = gpu_threads._thread(["  %v = getelementptr double, ptr %out, i64 %k"], [])
    assert apart == [
        "  %v.ahead = mul i64 %k, %samples",
        "  %v = getelementptr double, ptr %out, i64 %v.ahead",
    ]


WORDS = ctypes.c_uint64
LAUNCH = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_uint64, *[ctypes.c_uint] * 7, *[ctypes.c_void_p] * 3
)


def words(*values):
    return (WORDS * len(values))(*values)


def called(samples=100, context=7, code=0):
    """A handler called by a frame like XLA's, of one array in and two out: the error that it makes,
    and what it has launched."""
    at, launched, said = ctypes.addressof, [], []
    kept = []

    def buffer(place, size):
        sizes = words(size, samples)
        own = words(48, 0, 0, place, 2, at(sizes))
        kept.extend([sizes, own])
        return at(own)

    @ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.c_void_p)
    def stream_of(asked):
        WORDS.from_address(asked + 24).value = 1000 + WORDS.from_address(asked + 16).value
        return 0

    @ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.c_void_p)
    def error_of(given):
        said.append(ctypes.string_at(WORDS.from_address(given + 16).value).decode())
        return 99

    @ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_uint64, ctypes.c_void_p)
    def context_of(stream, place):
        WORDS.from_address(place).value = context
        return 0

    @LAUNCH
    def launch(function, *given):
        grid, threads, stream, parameters = given[0], given[3], given[7], given[8]
        places = [WORDS.from_address(parameters + 8 * k).value for k in range(4)]
        numbers = [WORDS.from_address(place).value for place in places]
        launched.append((function, grid, threads, stream, numbers))
        return code

    address = lambda function: ctypes.cast(function, ctypes.c_void_p).value
    arguments = words(buffer(501, 4))
    results = words(buffer(601, 3), buffer(602, 9))
    interface = words(0, 0, 0, 0, 0, 0, address(error_of), 0, 0, 0, address(stream_of))
    frame = (WORDS * 24)()
    frame[2], frame[3], frame[9], frame[14] = at(interface), 5, at(arguments), at(results)
    places = address(context_of), address(launch)
    loaded = [gpu_driver.Loaded(6, 41, 0, 0), gpu_driver.Loaded(7, 42, 0, 0)]
    engine = object_code.compiled(gpu_call.handler_text("handler", loaded, 1, 2, places))
    handler = ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.c_void_p)
    error = handler(engine.get_function_address("handler"))(at(frame))
    assert bool(error) == bool(said)
    return said, launched


def test_a_launch_goes_on_xlas_stream_with_the_arrays_places():
    said, launched = called()
    # The stream that XLA gives for its context, number 5; the kernel of the stream's device.
    assert launched == [(42, 2, 64, 1005, [100, 501, 601, 602])]
    assert not said
    assert called(samples=0) == ([], [])


def test_a_failing_launch_is_an_error_of_xla():
    assert called(code=2)[0] == [gpu_call.FAILED]
    assert called(context=8) == ([gpu_call.ELSEWHERE], [])


needs_ptxas = pytest.mark.skipif(
    ptxas() is None, reason="NVIDIA's assembler is in the package nvidia-cuda-nvcc-cu12"
)


def programs_of(scene, rung, built):
    problem = question(scene, RUNGS[rung], 1e-3)
    values = jnp.asarray(np.asarray(problem.nominal())[None])
    jax.jit(jax.vmap(lambda value: problem.started(problem.setting(value))[2])).lower(values)
    return built


@needs_ptxas
def test_a_step_of_a_slider_crank_stays_in_a_threads_registers(built):
    programs = programs_of(jc.scenes.slider_crank(), "fixed", built)
    for program in programs:
        found = assembled(program)
        # Some may stand aside so that more threads fit beside each other.
        assert found.registers <= 255 and found.stored <= 128


@needs_ptxas
@pytest.mark.slow
@pytest.mark.parametrize(("name", "rung"), list(scenes_and_rungs()))
def test_nvidias_assembler_takes_every_scene(name, rung, built):
    scene = getattr(jc.scenes, name)(**GIVEN.get(name, {}))
    try:
        programs = programs_of(scene, rung, built)
    except (ValueError, StopIteration) as refused:
        pytest.skip(str(refused))
    for program in programs:
        # Larger ones take the assembler minutes.
        if gpu_threads.text_of(program).count("\n") < 10_000:
            assert assembled(program).registers <= 255
