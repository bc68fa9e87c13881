"""Kernels on a GPU, as far as none is needed: each thread's text gives the bits of the processor's
kernel, the whole way from a program of JAX to the launch, by an imagined device; NVIDIA's assembler
takes the PTX, where it is installed; and what is refused is said.
"""

import ctypes
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
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
    return jax.device_get(jax.jit(jax.vmap(lambda value: problem._simulated(value)))(values))


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
    problem = question(bouncing(), RUNGS[rung], 5e-3)
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
    np.testing.assert_array_equal(found[1], values)
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


def test_nothing_of_it_is_loaded_unless_it_is_asked_for():
    look = (
        "import sys, jax, jaxclear\n"
        "from jaxclear.native import has_kernels\n"
        "assert has_kernels()\n"
        "assert not [name for name in sys.modules if 'native.gpu' in name]\n"
    )
    subprocess.run([sys.executable, "-c", look], check=True, env=os.environ | {loop.ON_GPU: "1"})


def test_memory_used_in_a_way_that_is_not_known_is_refused():
    with pytest.raises(Unsupported, match="ptrtoint"):
        gpu_threads._thread(["  %v = ptrtoint ptr %in to i64"], [])
    with pytest.raises(Unsupported, match="not known on a GPU"):
        gpu_threads._thread(["  %v = load double, ptr %of_nobody"], [])


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
    places = gpu_call.Places(address(context_of), address(launch))
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


def ptxas():
    spec = importlib.util.find_spec("nvidia")
    for folder in (spec.submodule_search_locations or []) if spec else []:
        for found in Path(folder).glob("*/bin/ptxas"):
            return str(found)
    return None


needs_ptxas = pytest.mark.skipif(
    ptxas() is None, reason="NVIDIA's assembler is in the package nvidia-cuda-nvcc-cu12"
)


def assembled(program, folder):
    """What NVIDIA's assembler says of a loop's kernel: registers of a thread, and bytes that it
    stores beside them."""
    ptx = gpu_ptx.ptx_of(gpu_threads.text_of(program).replace("@NAME", "@jaxclear"), "sm_80")
    (folder / "kernel.ptx").write_text(ptx)
    asked = [ptxas(), "-v", "-arch=sm_90", folder / "kernel.ptx", "-o", folder / "kernel.cubin"]
    said = subprocess.run(asked, capture_output=True, text=True, check=True)
    own = said.stdout + said.stderr
    count = lambda form: max(int(number) for number in re.findall(form, own))
    return count(r"Used (\d+) registers"), count(r"(\d+) bytes spill stores")


def programs_of(scene, rung, built):
    problem = question(scene, RUNGS[rung], 1e-3)
    values = jnp.asarray(np.asarray(problem.nominal())[None])
    jax.jit(jax.vmap(lambda value: problem._simulated(value))).lower(values)
    return built


@needs_ptxas
def test_a_step_of_a_slider_crank_stays_in_a_threads_registers(built, tmp_path):
    programs = programs_of(jc.scenes.slider_crank(), "fixed", built)
    for program in programs:
        registers, stored = assembled(program, tmp_path)
        # Some may stand aside so that more threads fit beside each other.
        assert registers <= 255 and stored <= 128


@needs_ptxas
@pytest.mark.slow
@pytest.mark.parametrize(("name", "rung"), list(scenes_and_rungs()))
def test_nvidias_assembler_takes_every_scene(name, rung, built, tmp_path):
    scene = getattr(jc.scenes, name)(**GIVEN.get(name, {}))
    try:
        programs = programs_of(scene, rung, built)
    except (ValueError, StopIteration) as refused:
        pytest.skip(str(refused))
    for program in programs:
        # Larger ones take the assembler minutes.
        if gpu_threads.text_of(program).count("\n") < 10_000:
            assert assembled(program, tmp_path)[0] <= 255
