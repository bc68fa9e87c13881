"""Loops as machine code give what JAX's own loops give: every rule, alone and in a batch, or they
step aside."""

import logging
import re
import warnings
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear  # noqa: F401  (float64)
from jaxclear.native import (
    arithmetic,
    check,
    control,
    dispatch,
    kernel,
    loop,
    object_code,
    while_loop,
    with_fast_loops,
    writer,
)
from jaxclear.native.writer import Unsupported

# The same operations in another order, fused multiply-adds: rounding of a few turns.
ROUNDING = 1e-12
slowly = pytest.mark.filterwarnings("ignore:jaxclear runs a time loop")


def turns(step, count):
    """The loop of `count` turns of x -> step(x), by both."""

    def by(make):
        return lambda x: make(lambda s: s[0] < count, lambda s: (s[0] + 1, step(s[1])), (0, x))[1]

    return by(while_loop), by(jax.lax.while_loop)


def test_elementary_functions_become_part_of_a_kernel():
    """No call of them is left, and nothing that is not used."""
    llvm = pytest.importorskip("llvmlite.binding")
    call = "  %s = call double @jc.twice(double %x)\n  %t = fadd double %s, %s\n  ret double %s"
    text = (
        "define internal double @jc.twice(double %x) nounwind willreturn memory(none) {\n"
        "  %y = fadd double %x, %x\n  ret double %y\n}\n"
        f"define double @loop(double %x) {{\n{call}\n}}"
    )
    module = llvm.parse_assembly(text)
    object_code.optimise(module, object_code._target_machine())
    lines = str(module.get_function("loop")).splitlines()
    assert sum("fadd" in line for line in lines) == 1
    assert not any("call" in line for line in lines)


def index(x, size):
    return jnp.clip((jnp.abs(x) * size).astype(int), 0, size - 1)


@pytest.mark.parametrize("lanes", [1, 8])
def test_long_scans_are_loops(lanes, monkeypatch):
    """Beyond a size the turns of a scan are not written out: its text does not grow with them."""
    rng = np.random.default_rng(0)

    def loop_over(matrices):
        def step(x):
            turn = lambda c, m: (jnp.sin(m @ jnp.sin(m @ c)) + 0.1, None)
            return jax.lax.scan(turn, x, matrices)[0]

        return turns(step, 2)

    matrices = rng.normal(size=(4, 3, 3)) / 3
    written = []
    text_of = kernel.text_of
    monkeypatch.setattr(kernel, "text_of", lambda *a: written.append(text_of(*a)) or written[-1])
    x = jnp.asarray(rng.uniform(-1.0, 1.0, (lanes, 3)))
    found = []
    for limit in (control.LARGEST_WRITTEN_OUT, 1):
        monkeypatch.setattr(control, "LARGEST_WRITTEN_OUT", limit)
        found.append(jax.jit(jax.vmap(loop_over(matrices)[0]))(x))
    wanted = jax.vmap(loop_over(matrices)[1])(x)
    np.testing.assert_allclose(found, [wanted] * 2, rtol=ROUNDING, atol=ROUNDING)
    # Six sines a turn, of four turns or of one, and their definition.
    assert [text.count("@jc.sincos(") for text in written] == [4 * 6 + 1, 6 + 1]


SPECIAL = [0.0, -0.0, 1e-300, 1.0, -1.0, np.pi / 4, np.pi / 2, 100.0, -1e5, 9.9e7, 1.1e8, 1e15]
SPECIAL += [np.inf, -np.inf, np.nan]


@pytest.mark.parametrize("lanes", [1, 8])
def test_sine_cosine_and_angle_are_good_to_two_units_in_the_last_place(lanes):
    rng = np.random.default_rng(3)
    x = np.concatenate([SPECIAL, rng.uniform(-10, 10, 2000), rng.uniform(-1e6, 1e6, 2000)])
    both = jax.jit(jax.vmap(turns(lambda p: jnp.stack([jnp.sin(p[0]), jnp.cos(p[0])]), 1)[0]))
    points = np.stack([x, x], 1)
    found = np.concatenate(
        [np.asarray(both(points[i : i + 1])) for i in range(60)]
        if lanes == 1
        else [np.asarray(both(points))]
    )
    x = x[: len(found)]
    with np.errstate(invalid="ignore"):
        for column, function in enumerate((np.sin, np.cos)):
            assert_units(found[:, column], function(x), 2, 1e-16)
    y, x = rng.normal(size=(2, 3000)) * 10.0 ** rng.uniform(-8, 8, (2, 3000))
    corners = np.array(
        [(a, b) for a in (0.0, -0.0, 1.0, -1.0) for b in (0.0, 1.0, -1.0, 0.66, -0.5)]
    )
    y, x = np.concatenate([y, corners[:, 0]]), np.concatenate([x, corners[:, 1]])
    angle = jax.jit(jax.vmap(turns(lambda p: jnp.stack([jnp.arctan2(p[0], p[1]), p[1]]), 1)[0]))
    assert_units(np.asarray(angle(np.stack([y, x], 1)))[:, 0], np.arctan2(y, x), 2, 0.0)


def assert_units(found, wanted, units, floor):
    """Within some units in the last place (or an absolute floor near zeros of the function)."""
    np.testing.assert_array_equal(np.isnan(found), np.isnan(wanted))
    good = ~np.isnan(wanted)
    off = np.abs(found - wanted)[good] / np.maximum(np.spacing(np.abs(wanted[good])), floor)
    assert off.max() <= units


def test_each_sample_ends_by_itself():
    def count(limit):
        return while_loop(lambda s: s[1] < limit, lambda s: (s[0] + 1, s[1] * 2.0 + 0.1), (0, 1.0))[
            0
        ]

    limits = jnp.array([0.5, 3.0, 1e6, 10.0, 1e3, 2.0, 2.5, 7.0, 1e9])
    assert jax.vmap(count)(limits).tolist() == [int(count(x)) for x in limits]


def test_batches_of_batches():
    fast, plain = turns(jnp.cos, 5)
    x = jnp.arange(6.0).reshape(2, 3)
    np.testing.assert_allclose(
        jax.vmap(jax.vmap(fast))(x), jax.vmap(jax.vmap(plain))(x), rtol=ROUNDING
    )


def test_numbers_from_outside_the_loop_can_vary_without_compiling_again():
    traces = []

    @jax.jit
    def f(x, factor, table):
        traces.append(1)
        return while_loop(
            lambda s: s[0] < 3,
            lambda s: (s[0] + 1, s[1] * factor + table[index(s[1], 100)]),
            (0, x),
        )[1]

    table = np.linspace(0.0, 1.0, 100)
    for factor in (0.5, 0.7):
        wanted = 0.4
        for _ in range(3):
            wanted = wanted * factor + table[min(int(abs(wanted) * 100), 99)]
        assert np.isclose(f(0.4, factor, table), wanted, rtol=ROUNDING)
    assert len(traces) == 1


def test_a_part_without_a_rule_is_left_to_jax_and_warns_once(monkeypatch, recwarn):
    monkeypatch.setattr(loop, "_WARNED", set())
    for factor in (0.3, 0.31):
        fast, plain = turns(lambda x: jnp.cumsum(jnp.sort(x)) * factor, 3)
        x = jnp.array([0.3, -0.7, 0.2])
        with warnings.catch_warnings():
            warnings.simplefilter("default")
            np.testing.assert_allclose(jax.jit(fast)(x), plain(x), rtol=ROUNDING)
    (said,) = [str(w.message) for w in recwarn]
    assert "ten times as long" in said and re.search("the primitive (sort|cumsum)", said)


@slowly
@pytest.mark.parametrize(
    "step",
    [lambda x, t: x + t.sum(), lambda x, t: jax.lax.scan(lambda c, r: (c + r, None), x, t)[0]],
)
def test_arithmetic_on_long_arrays_is_left_to_jax(step):
    def by(make):
        return lambda x, table: make(
            lambda s: s[0] < 2, lambda s: (s[0] + 1, step(s[1], table)), (0, x)
        )[1]

    table = jnp.linspace(0.0, 1.0, 90)
    assert np.isclose(
        jax.jit(by(while_loop))(0.3, table), by(jax.lax.while_loop)(0.3, table), rtol=ROUNDING
    )


def test_a_kernel_that_cannot_be_written_costs_a_warning_not_the_run(monkeypatch):
    monkeypatch.setattr(loop, "_WARNED", set())
    monkeypatch.setattr(kernel, "build", lambda *_: 1 / 0)
    by_kernel, by_jax = turns(lambda x: 0.37 * x + 0.21, 5)
    with pytest.warns(RuntimeWarning, match="could not be written"):
        found = jax.jit(by_kernel)(jnp.array([0.3, 0.7]))
    np.testing.assert_allclose(found, by_jax(jnp.array([0.3, 0.7])), rtol=ROUNDING)


def test_kernels_are_checked_where_that_is_asked_for(monkeypatch):
    looks, compared = [], check.compared
    monkeypatch.setattr(
        check, "compared", lambda *given: looks.append(compared(*given)) or looks[-1]
    )
    for wanted, factor in (("0", 0.43), ("1", 0.44)):
        monkeypatch.setenv("JAXCLEAR_CHECK_KERNELS", wanted)
        jax.jit(turns(lambda x, factor=factor: x * factor + 1.0, 3)[0])(0.3)
        assert bool(looks) == (wanted == "1")
    assert all(look == (check.Judgement(True, True), True) for look in looks)


def test_rounding_where_a_sum_cancels_is_no_disagreement(caplog, checked):
    """x - x (1 + tiny) + ... leaves rounding of either order; both are right."""
    with caplog.at_level(logging.INFO, logger="jaxclear.native.loop"):
        by_kernel, _ = turns(lambda x: x + (0.1 * x[::-1] - (x + 0.1 * x[::-1])), 3)
        jax.jit(by_kernel)(jnp.array([0.3, 0.7]))
    assert not caplog.records


@slowly
def test_a_wrong_kernel_is_caught_and_not_used(monkeypatch, caplog, checked):
    monkeypatch.setitem(writer.RULES, "mul", writer.RULES["add"])
    monkeypatch.setitem(arithmetic._FLOAT_OPS, "mul", "fadd")
    fast, plain = turns(lambda x: x * 0.37 + 1.0, 3)
    with caplog.at_level(logging.INFO, logger=loop.LOG.name):
        assert np.isclose(jax.jit(fast)(0.3), plain(0.3), rtol=ROUNDING)
    assert "does not agree" in caplog.text


@slowly
@pytest.mark.parametrize("beyond", [-1e-6, 1.5, 1e-2])
def test_a_kernel_that_is_wrong_in_some_states_only_is_caught(beyond, monkeypatch, caplog, checked):
    """Of negative numbers, of large ones, of small ones: those that a contact parts by."""
    monkeypatch.setitem(writer.RULES, "mul", writer.RULES["add"])
    monkeypatch.setitem(arithmetic._FLOAT_OPS, "mul", "fadd")
    there = (lambda x: x > beyond) if beyond > 1 else (lambda x: x < beyond)
    fast, plain = turns(lambda x: jnp.where(there(x), x * x, x + 1.0), 3)
    with caplog.at_level(logging.INFO, logger=loop.LOG.name):
        x = jnp.full(6, 2 * beyond)
        np.testing.assert_allclose(jax.jit(fast)(x), plain(x), rtol=ROUNDING)
    assert "does not agree" in caplog.text


def test_a_check_looks_at_states_within_and_beyond_a_clearance():
    number = jax.ShapeDtypeStruct((), float)
    for draw in range(5):
        samples = check.random_values([number], [number, number], draw)
        overlaps = [np.hypot(x, y) - clearance for clearance, x, y in samples]
        assert overlaps[1] < 0 < overlaps[2]


@pytest.fixture
def header_of_xla(monkeypatch, tmp_path):
    """The header of XLA's foreign function interface, which may be written anew."""
    text = (Path(jax.ffi.include_dir()) / "xla/ffi/api/c_api.h").read_text()
    header = tmp_path / "xla/ffi/api/c_api.h"
    header.parent.mkdir(parents=True)
    header.write_text(text)
    monkeypatch.setattr(jax.ffi, "include_dir", lambda: str(tmp_path))
    dispatch.interface_version.cache_clear()
    yield header
    monkeypatch.undo()
    dispatch.interface_version.cache_clear()


def test_an_unknown_interface_of_xla_is_refused(header_of_xla):
    header_of_xla.write_text("struct XLA_FFI_CallFrame { int other; };")
    with pytest.raises(Unsupported, match="foreign function interface"):
        dispatch.interface_version()


def test_the_interface_of_xla_is_known_by_the_names_of_jax_0_12(header_of_xla):
    """Whose header (its minor version 5) calls some structures and functions otherwise, and lays
    them out alike."""
    text, version = header_of_xla.read_text(), dispatch.interface_version()
    for before, now in {
        "XLA_FFI_Error_GetMessage": "XLA_FFI_Error_GetDetails",
        "XLA_FFI_Extension_Base": "XLA_FFI_InternalExtension",
        "XLA_FFI_ExecutionContext": "XLA_FFI_InvokeContext",
    }.items():
        text = text.replace(before, now)
    header_of_xla.write_text(text)
    dispatch.interface_version.cache_clear()
    assert dispatch.interface_version() == version


def test_the_switch_leaves_loops_to_jax(monkeypatch):
    monkeypatch.setenv("JAXCLEAR_PLAIN_LOOPS", "1")
    monkeypatch.setattr(loop.kernels, "build", lambda *_: pytest.fail("the switch was not read"))
    fast, plain = turns(lambda x: x * 0.41 + 1.0, 3)
    assert np.isclose(jax.jit(fast)(0.3), plain(0.3), rtol=ROUNDING)


def test_a_body_that_changes_type_is_refused():
    with pytest.raises(TypeError, match="must keep shapes and types"):
        while_loop(lambda x: x < 3, lambda x: x + 0.5, 0)


def test_adaptive_loops_of_diffrax(caplog):
    def solve(rate):
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, y, args: jnp.stack([y[1], -args * jnp.sin(y[0])])),
            diffrax.Tsit5(),
            0.0,
            5.0,
            0.1,
            jnp.array([1.0, 0.0]),
            args=rate,
            stepsize_controller=diffrax.PIDController(rtol=1e-9, atol=1e-11),
            adjoint=diffrax.ForwardMode(),
        )
        return solution.ys[-1], solution.stats["num_steps"]

    rates = jnp.array([1.0, 4.0, 9.0])
    with caplog.at_level(logging.INFO, logger=loop.LOG.name):
        fast, steps = jax.jit(jax.vmap(with_fast_loops(solve)))(rates)
    assert not caplog.records
    wanted, wanted_steps = jax.vmap(solve)(rates)
    # Rounding of hundreds of steps; the number of steps may differ by one where an error is just at
    # the tolerance.
    np.testing.assert_allclose(fast, wanted, rtol=1e-9)
    assert np.abs(steps - wanted_steps).max() <= 1
    slope = jax.jvp(lambda r: with_fast_loops(solve)(r)[0], (2.0,), (1.0,))[1]
    np.testing.assert_allclose(slope, jax.jvp(lambda r: solve(r)[0], (2.0,), (1.0,))[1], rtol=1e-9)


def test_what_is_written_is_read_within_its_region_alone():
    text = writer.Writer(4)
    product = text.put("fmul double %a, %b")
    outer = text.enter()
    assert text.put("fmul double %a, %b") == product
    inside = text.put("fmul double %a, %c")
    assert text.put("fmul double %a, %c") == inside
    text.leave(outer)
    assert text.put("fmul double %a, %c") != inside
    assert len(text.lines) == 3


def test_memory_that_changes_is_read_anew():
    text = writer.Writer(1)
    changing, fixed = "load double, ptr %a", "load double, ptr %a, !invariant.load !0"
    assert text.put(changing) != text.put(changing)
    assert text.put(fixed) == text.put(fixed)


def test_equations_that_stand_in_a_program_several_times_are_one_in_its_kernel(built):
    rate = lambda x: jnp.tanh(x) * jnp.cosh(x)

    def run(x, times):
        turn = lambda s: (s[0] + 1, s[1] + sum(1e-3 * rate(s[1]) for _ in range(times)))
        return while_loop(lambda s: s[0] < 5, turn, (jnp.zeros((), int), x))[1]

    once, often = (jax.jit(run, static_argnums=1)(0.3, times) for times in (1, 7))
    texts = [kernel.text_of(program, 1) for program in built]
    assert [text.count("call double @tanh") for text in texts] == [1, 1]
    assert np.isfinite(once) and often > once


def in_parts(counts, first, resumed):
    """(turns of the loop around, what the parts add up): so many steps in each part in turn. Where
    its loop is `resumed`, a turn takes up what the one before has left of a part."""

    def turn(now):
        turns, part, step, total = now
        goes_on = lambda inner: inner[0] < counts[part]
        inner = step, total
        step, total = while_loop(
            goes_on,
            lambda inner: (inner[0] + 1, jnp.sin(inner[1] + 0.3)),
            inner,
            resumed=resumed,
        )
        done = ~goes_on((step, total))
        return turns + 1, jnp.where(done, part + 1, part), jnp.where(done, 0, step), total

    none = jnp.zeros((), int)
    last = while_loop(lambda now: now[1] < len(counts), turn, (none, none, none, first))
    return last[0], last[3]


def test_half_of_the_samples_do_not_wait_for_the_others():
    """What each of them computes is the same to the last digit."""
    counts = np.random.default_rng(0).integers(1, 30, (16, 12))
    first = np.linspace(0.0, 1.0, 16)
    run = lambda resumed: jax.jit(jax.vmap(lambda c, x: in_parts(c, x, resumed)))(counts, first)
    (turns, total), (turns_together, total_together) = run(True), run(False)
    np.testing.assert_array_equal(total, total_together)
    assert np.all(turns_together == 12) and np.any(turns > 12)
    alone = jax.jit(lambda c, x: in_parts(c, x, True))(counts[3], first[3])
    assert int(alone[0]) == 12
    np.testing.assert_allclose(alone[1], total[3], rtol=1e-15)
