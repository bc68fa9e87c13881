"""Kernels go with the programs that call them, and a program whose kernel has gone says so."""

import collections
import ctypes
import gc
import os
import threading
import time
import weakref

import jax
import jax.numpy as jnp
import pytest

import jaxclear  # noqa: F401  (float64)
from jaxclear.native import dispatch, kernel, while_loop

PROGRAMS = 30


def program(number, terms=3):
    def step(x):
        return 0.1 * sum(jnp.sin(x * k + number) for k in range(terms))

    run = jax.jit(
        lambda x: while_loop(lambda s: s[0] < 3, lambda s: (s[0] + 1, step(s[1])), (0, x))
    )
    return run, run(jnp.ones(3))[1]


@pytest.fixture
def latest(monkeypatch):
    """So few programs count as the latest, which keep their kernels."""
    monkeypatch.setattr(kernel, "LATEST", 2)
    monkeypatch.setattr(kernel, "_LATEST", collections.deque(maxlen=2))


def resident():
    """Memory that this process holds [bytes]."""
    gc.collect()
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096


def test_kernels_are_freed_with_their_programs(latest):
    kept, _ = program(0.5)
    gc.collect()
    table, known = dispatch.size(), len(kernel._KERNELS)
    for number in range(2 * kernel.LATEST):
        program(number)
    gc.collect()
    # The latest ones stay: a run of them may not have ended.
    assert dispatch.size() <= table + kernel.LATEST
    assert len(kernel._KERNELS) <= known + kernel.LATEST
    again, wanted = program(0.5)
    assert jnp.array_equal(kept(jnp.ones(3))[1], wanted)
    del again


@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="no /proc here")
@pytest.mark.slow
def test_memory_stays_flat_when_programs_are_dropped():
    """XLA keeps some 0.7 MB of a program that is dropped; a kernel took 2 MB beside that."""
    for number in range(5):
        program(1000 + number, 20)
    before = resident()
    for number in range(PROGRAMS):
        program(2000 + number, 20)
    assert resident() - before < PROGRAMS * 1.5e6


def test_a_program_whose_kernel_has_gone_says_so():
    run, _ = program(7.5)
    own = [k for k in kernel._KERNELS.values() if dispatch.TABLE[2 * dispatch._place(k.number)]]
    addresses = {k.number: k._entry for k in own}
    try:
        for number, address in addresses.items():
            dispatch.remove(number, address)
        with pytest.raises(ValueError, match="kernel of this program"):
            jax.block_until_ready(run(jnp.zeros(3)))
    finally:
        for number, address in addresses.items():
            dispatch.enter_kernel(number, address)
    assert jnp.isfinite(run(jnp.zeros(3))[1]).all()


def test_another_kernel_takes_the_place_of_one_that_has_gone(monkeypatch):
    """Numbers that begin at one place of the table stand behind each other."""
    monkeypatch.setattr(dispatch, "TABLE", (ctypes.c_int64 * (2 * dispatch.PLACES))())
    first, second, third = (1 + k * dispatch.PLACES for k in range(3))
    dispatch.enter_kernel(first, 11)
    dispatch.enter_kernel(second, 22)
    dispatch.remove(first, 99)
    assert dispatch.size() == 2
    dispatch.remove(first, 11)
    dispatch.enter_kernel(third, 33)
    assert dispatch.size() == 2 and list(dispatch.TABLE[2:6]) == [third, 33, second, 22]


def test_kernels_of_the_latest_program_all_stay_however_many_they_are(latest):
    """A derivative of a guide both of whose parts wear has more kernels than were kept, and lost
    some before it had run."""
    before = set(kernel._KERNELS)

    def run(x):
        for number in range(2 * kernel.LATEST):
            turn = lambda s, number=number: (s[0] + 1, 0.5 * s[1] + 0.1 * number)
            x = while_loop(lambda s: s[0] < 3, turn, (0, x))[1]
        return x

    jax.jit(run)(1.0)
    del run
    gc.collect()
    assert len(set(kernel._KERNELS) - before) == 2 * kernel.LATEST


class Code:
    """In the place of an engine: what holds the machine code."""


def test_the_code_of_a_kernel_goes_when_the_last_call_of_it_has_ended():
    """Also where its program, and many after it, are dropped while it runs."""
    turn = lambda s: (s[0] + 1.0, 0.5 * s[1] + 1.0)
    run = jax.jit(lambda x, most: while_loop(lambda s: s[0] < most, turn, (0.0, x))[1])
    run(0.0, 1.0)
    own, code = kernel._LATEST[-1][-1], Code()
    place, held, found = dispatch._place(own.number), weakref.ref(code), []
    call = threading.Thread(target=lambda: found.append(float(run(0.0, 3e8))))
    call.start()
    end = time.monotonic() + 20.0
    while not dispatch.is_in_use(place) and time.monotonic() < end:
        time.sleep(1e-3)
    assert dispatch.is_in_use(place)
    kernel._dropped(own.number, own._entry, code)
    del code
    kernel.free_the_unused()
    assert held() is not None
    with pytest.raises(ValueError, match="kernel of this program"):
        run(0.0, 1.0)
    call.join()
    kernel.free_the_unused()
    assert held() is None and not dispatch.is_in_use(place)
    assert found == [2.0]
