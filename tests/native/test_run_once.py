"""Kernels that run once are compiled without optimisation, all others with it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.native import compiled, in_one, kernel, object_code, rows, while_loop
from tests.rigs.spatial_loops import hinge_loops


@pytest.fixture
def requests(monkeypatch):
    """Of each kernel that is requested in turn, whether it runs once, by its number."""
    kernels, build = [], kernel.build

    def recorded(program, lanes, is_run_once=False):
        result = build(program, lanes, is_run_once)
        kernels.append((result.number, is_run_once))
        return result

    monkeypatch.setattr(kernel, "build", recorded)
    return kernels


def is_each_run_once(requests):
    return [is_run_once for _, is_run_once in requests]


def test_the_start_of_a_mechanism_is_not_optimised(requests):
    jc.assemble(hinge_loops(1, {"load of a start that is not optimised": jc.load.Gravity()}))
    assert requests and all(is_each_run_once(requests))


def test_the_time_loop_of_a_run_is_optimised(requests):
    pendulum = jc.Mechanism(
        {"optimised pendulum": jc.Body(1.0, (1e-3, 1e-3, 1e-3), (0.0, -0.1, 0.0))},
        {"O": jc.Connection(jc.joint.Revolute(), "ground", "optimised pendulum")},
        {"gravity": jc.load.Gravity()},
    )
    step = jc.integrator.FixedStep(1e-4)
    run = jc.simulate(pendulum, 3e-4, integrator=step, save=2, verify=False)
    assert run.succeeded and requests and not any(is_each_run_once(requests))


def _function(x):
    def wave(x):
        for k in range(8):
            x = jnp.sin(x) + 0.1 * k
        return x

    return in_one(wave, x)


def test_only_what_runs_once_on_one_sample_is_not_optimised(requests, monkeypatch):
    monkeypatch.setattr(rows, "SHORT", 4)
    quick = compiled.compiled_quickly(_function)
    value = quick(0.3)
    assert is_each_run_once(requests) == [True]
    # In a program of the user's, which may run often; in a batch; and a loop of any length.
    in_program = jax.jit(quick)(0.3)
    batch = compiled.compiled_quickly(jax.vmap(_function))(jnp.array([0.3, 0.4, 0.5]))
    compiled.compiled_for_kernels(lambda x: _function(x))(0.3)
    turn = lambda s: (s[0] + 1, _function(s[1]))
    compiled.compiled_quickly(lambda x: while_loop(lambda s: s[0] < 1, turn, (0, x))[1])(0.3)
    assert is_each_run_once(requests) == [True, False, False, False, False]
    assert requests[0][0] != requests[1][0]
    np.testing.assert_allclose([in_program, batch[0]], value, rtol=1e-15)


@pytest.mark.parametrize("is_run_once", (False, True))
def test_what_runs_once_takes_no_pass_and_the_lowest_level(is_run_once, monkeypatch):
    levels, passes, machine = [], [], object_code._target_machine

    def recorded(level=object_code.CODE_LEVEL):
        levels.append(level)
        return machine(level)

    monkeypatch.setattr(object_code, "_target_machine", recorded)
    monkeypatch.setattr(object_code, "optimise", lambda *_: passes.append(True))
    monkeypatch.setattr(object_code, "SPEED_LEVEL", 1)
    text = f"define i64 @jaxclear_test_{is_run_once}() {{\n  ret i64 7\n}}"
    object_code.load_or_compile(text, is_run_once)
    assert (levels[0], passes) == ((0, []) if is_run_once else (3, [True]))
