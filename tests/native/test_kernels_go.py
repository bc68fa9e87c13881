"""Kernels go with the programs that call them, and a program whose kernel has gone says so."""

import gc
import os
import threading
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax._src import pjit
from jax._src.interpreters import pxla
from jax.experimental import serialize_executable

import jaxclear  # noqa: F401  (float64)
from jaxclear.native import dispatch, kernel, while_loop

pytestmark = pytest.mark.usefixtures("young_garbage")
PROGRAMS = 30


def program(number, terms=3):
    def step(x):
        return 0.1 * sum(jnp.sin(x * k + number) for k in range(terms))

    run = jax.jit(
        lambda x: while_loop(lambda s: s[0] < 3, lambda s: (s[0] + 1, step(s[1])), (0, x))[1]
    )
    return run, run(jnp.ones(3))


def empty_caches_of_python():
    """What happens to the oldest program when JAX has compiled 2048 others: its caches in Python
    forget it, and that of `jax.jit` in C++ does not."""
    for cache in (pjit._pjit_lower, pxla._cached_compilation, pxla._cached_lowering_to_hlo):
        cache.cache_clear()
    gc.collect()


def new_row(before):
    """The row in the table of the one kernel that is new."""
    (number,) = set(kernel._KERNELS) - before
    return dispatch.row_of_kernel(number)


def is_in_table(row):
    gc.collect()
    kernel.free_the_unused()
    return bool(row.address)


def happens(condition):
    """Whether a condition holds soon: an executable lives until its last call has ended, and XLA
    ends calls in a thread of its own, behind their results."""
    end = time.monotonic() + 20.0
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
        gc.collect()
        kernel.free_the_unused()
    return condition()


def has_gone(row):
    """Whether no executable calls the kernel of a row any more, and it is freed."""
    return happens(lambda: not is_in_table(row) and row.executables == 0)


def resident():
    """Memory that this process holds [bytes]."""
    gc.collect()
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096


def test_kernels_are_freed_with_their_programs():
    cached, expected = program(0.5)
    gc.collect()
    kernel.free_the_unused()
    table, kernels = dispatch.size(), len(kernel._KERNELS)
    for number in range(3):
        program(number)
    assert happens(lambda: dispatch.size() <= table and len(kernel._KERNELS) <= kernels)
    assert jnp.array_equal(cached(jnp.ones(3)), expected)


def test_a_program_runs_when_only_its_executable_is_left_and_its_kernel_goes_with_it():
    before = set(kernel._KERNELS)
    run, expected = program(1.5)
    row = new_row(before)
    empty_caches_of_python()
    assert row.number not in kernel._KERNELS
    assert is_in_table(row) and row.executables == 1
    assert jnp.array_equal(run(jnp.ones(3)), expected)
    del run
    assert has_gone(row)


def test_a_program_from_disk_keeps_its_kernel_though_it_is_there_before_it():
    before = set(kernel._KERNELS)
    run, expected = program(2.5)
    row = new_row(before)
    content, *trees = serialize_executable.serialize(run.lower(jnp.ones(3)).compile())
    loaded = serialize_executable.deserialize_and_load(content, *trees)
    assert row.executables >= 2
    del run
    empty_caches_of_python()
    assert jnp.array_equal(loaded(jnp.ones(3)), expected)
    del loaded
    assert has_gone(row)


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
    before = set(kernel._KERNELS)
    run, _ = program(7.5)
    row = new_row(before)
    address = row.address
    dispatch.remove(row.number, address + 1)
    assert row.address == address
    try:
        dispatch.remove(row.number, address)
        with pytest.raises(ValueError, match="kernel of this program"):
            jax.block_until_ready(run(jnp.zeros(3)))
    finally:
        dispatch.enter_kernel(row.number, address)
    assert jnp.isfinite(run(jnp.zeros(3))).all()


def test_numbers_that_begin_at_one_row_stand_behind_each_other():
    first, second = (123 + k * dispatch.ROWS for k in (1, 2))
    rows = [dispatch.row_of_kernel(number) for number in (first, second)]
    assert [row.number for row in rows] == [first, second]
    assert dispatch.row_of_kernel(second).executables == 0
    rows[0].address, rows[1].address = 11, 22
    dispatch.remove(first, 11)
    assert [row.address for row in map(dispatch.row_of_kernel, (first, second))] == [0, 22]
    dispatch.remove(second, 22)


def test_a_full_table_says_so(monkeypatch):
    monkeypatch.setattr(dispatch, "_machine_function", lambda *_: lambda number: None)
    with pytest.raises(MemoryError, match=f"{dispatch.ROWS} kernels"):
        dispatch.row_of_kernel(3)


def test_a_kernel_stays_until_its_last_call_has_ended():
    """Also where its program is dropped from all caches while it runs."""
    before, has_started, results = set(kernel._KERNELS), threading.Event(), []

    def start(x):
        has_started.set()
        return np.asarray(x)

    def run(most):
        first = jax.pure_callback(start, jax.ShapeDtypeStruct((), float), 0.0)
        turn = lambda s: (s[0] + 1.0, 0.5 * s[1] + 1.0)
        return while_loop(lambda s: s[0] < most, turn, (first, 0.0))[1]

    compiled = [jax.jit(run).lower(1.0).compile()]
    row = new_row(before)
    call = threading.Thread(target=lambda: results.append(float(compiled.pop()(3e8))))
    call.start()
    assert has_started.wait(60.0)
    del run
    empty_caches_of_python()
    is_there = is_in_table(row)
    assert is_there or not call.is_alive()
    call.join()
    del call
    assert results == [2.0]
    assert has_gone(row)
