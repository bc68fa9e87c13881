"""What is written of a program: nothing twice where it can be read."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.native import loop, while_loop
from jaxclear.native.writer import Writer


def test_what_is_written_is_read_within_its_region_alone():
    writer = Writer(4)
    product = writer.put("fmul double %a, %b")
    outer = writer.enter()
    assert writer.put("fmul double %a, %b") == product
    inside = writer.put("fmul double %a, %c")
    assert writer.put("fmul double %a, %c") == inside
    writer.leave(outer)
    assert writer.put("fmul double %a, %c") != inside
    assert len(writer.lines) == 3


def test_memory_that_changes_is_read_anew():
    writer = Writer(1)
    changing, fixed = "load double, ptr %a", "load double, ptr %a, !invariant.load !0"
    assert writer.put(changing) != writer.put(changing)
    assert writer.put(fixed) == writer.put(fixed)


def test_equations_that_stand_in_a_program_several_times_are_one_in_its_kernel(monkeypatch):
    built, build = [], loop.kernels.build
    monkeypatch.setattr(
        loop.kernels,
        "build",
        lambda program, lanes: (
            built.append(loop.kernels.text_of(program, lanes)) or build(program, lanes)
        ),
    )
    rate = lambda x: jnp.tanh(x) * jnp.cosh(x)

    def run(x, times):
        turn = lambda s: (s[0] + 1, s[1] + sum(1e-3 * rate(s[1]) for _ in range(times)))
        return while_loop(lambda s: s[0] < 5, turn, (jnp.zeros((), int), x))[1]

    once, often = (jax.jit(run, static_argnums=1)(0.3, times) for times in (1, 7))
    assert [text.count("call double @tanh") for text in built] == [1, 1]
    assert np.isfinite(once) and often > once
