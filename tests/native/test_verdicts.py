"""A compiled program tells whether its loops are machine code, and why not."""

import jax
import jax.numpy as jnp
import pytest

import jaxclear as jc
from jaxclear.native import check, explain, kernel, loop, verdict, while_loop

pytestmark = pytest.mark.filterwarnings("ignore:jaxclear runs a time loop.*(sort|agree)")
KERNELS = "The time loops ran as machine code."


def thrice(step):
    """Three loops of x -> step(x), and the verdict on them."""

    def program(x):
        def turn(c, _):
            return while_loop(lambda s: s[0] < 2, lambda s: (s[0] + 1, step(s[1])), (0, c))[1], None

        x = jax.lax.scan(turn, x, None, length=2)[0]
        x = while_loop(lambda s: s[0] < 2, lambda s: (s[0] + 1, 0.5 * s[1]), (0, x))[1]
        return x, verdict(x)

    return program


def said(program, x):
    return explain(jnp.max(program(x)[1]))


def test_kernels_are_told_alone_in_batches_and_again():
    program = jax.jit(thrice(lambda x: jnp.cos(x) + 0.17))
    assert said(program, 0.3) == said(program, 0.4) == KERNELS
    assert said(jax.jit(jax.vmap(thrice(lambda x: jnp.cos(x) + 0.17))), jnp.ones(3)) == KERNELS


def test_the_reason_is_told_of_each_program_by_itself():
    sorting, plain = jax.jit(thrice(jnp.sort)), jax.jit(thrice(jnp.sin))
    x = jnp.ones(3)
    reason = "1 of 2 time loops ran through XLA: there is no machine code for the primitive sort."
    assert said(sorting, x) == reason
    assert said(plain, x) == KERNELS
    assert said(sorting, x) == reason


def test_derivatives_of_a_loop_tell_of_its_kernel():
    program = jax.jit(thrice(jnp.tanh))
    (_, number), (_, tangent) = jax.jvp(program, (0.3,), (1.0,))
    assert explain(number) == KERNELS
    assert tangent.dtype == jax.dtypes.float0
    assert said(program, 0.3) == KERNELS


def test_the_switch_and_a_fault_are_told(monkeypatch):
    monkeypatch.setattr(kernel, "build", lambda *_: 1 / 0)
    monkeypatch.setattr(loop, "_WARNED", set())
    with pytest.warns(RuntimeWarning, match="could not be written"):
        assert "the kernel could not be written: ZeroDivisionError" in said(
            jax.jit(thrice(lambda x: 0.91 * x)), 0.3
        )
    monkeypatch.setenv("JAXCLEAR_PLAIN_LOOPS", "1")
    assert "switched off" in said(jax.jit(thrice(lambda x: 0.92 * x)), 0.3)


def test_a_number_of_another_process_says_so():
    assert "another process" in explain(-1)


@pytest.mark.slow
def test_a_run_tells_in_its_stats(monkeypatch):
    rig = jc.scenes.slider_crank(friction=False)
    go = lambda step: jc.simulate(rig, 1e-3, save=3, integrator=jc.integrator.FixedStep(step)).stats
    stats = go(2e-5)
    assert (stats.accepted_steps, stats.rejected_steps, stats.loops) == (50, 0, KERNELS)
    assert go(1e-5).loops == KERNELS
    monkeypatch.setenv("JAXCLEAR_PLAIN_LOOPS", "1")
    run = jc.simulate(rig, 1e-3, save=4, integrator=jc.integrator.FixedStep(2e-5))
    assert "switched off" in run.stats.loops


@pytest.mark.parametrize(
    ("refused", "factor"), [((0,), 0.93), ((0, 2), 0.94)], ids=["once", "again"]
)
def test_a_disagreement_that_does_not_recur_is_rounding(refused, factor, monkeypatch):
    """One draw in some thirty falls on a knife-edge between zero and rounding (seen in the four-bar
    with captured impacts); a fault shows in the draws after it too."""
    compared, nothing = check.compared, (check.Judgement(False, False), False)
    monkeypatch.setenv("JAXCLEAR_CHECK_KERNELS", "1")
    monkeypatch.setattr(
        check, "compared", lambda *given: nothing if given[-1] in refused else compared(*given)
    )
    sentence = said(jax.jit(thrice(lambda x: factor * x)), 0.3)
    assert sentence == KERNELS if len(refused) == 1 else "does not agree with JAX" in sentence


@pytest.mark.slow
def test_the_adaptive_four_bar_has_a_kernel():
    run = jc.simulate(jc.scenes.four_bar(), 1e-3, save=2, integrator=jc.integrator.Adaptive())
    assert run.stats.loops == KERNELS
