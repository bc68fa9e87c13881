"""The compiler option that jaxclear sets, and its own kernels, change speed, not results: the same
run with and without them, in processes of their own, because the option is read when JAX starts. A
user's own flags survive."""

import json
import os
import subprocess
import sys

import diffrax
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.simulation.simulate import is_all_kernel

RUN = """
import json, os, sys
import jaxclear as jc
if "flags" in sys.argv:
    print(json.dumps({"flags": os.environ.get("XLA_FLAGS", "")}))
    sys.exit()
rig = jc.scenes.four_bar(wear=False)
run = jc.simulate(rig, 0.02, save=3, integrator=jc.integrator.FixedStep(2e-5))
print(json.dumps({"states": run.states.tolist(), "flags": os.environ.get("XLA_FLAGS", "")}))
"""


def in_a_process(*words, **environment):
    environment = {
        key: value for key, value in os.environ.items() if key != "XLA_FLAGS"
    } | environment
    done = subprocess.run(
        [sys.executable, "-c", RUN, *words],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def plain():
    return in_a_process(JAXCLEAR_PLAIN_XLA="1", JAXCLEAR_PLAIN_LOOPS="1")


@pytest.mark.parametrize("kernels", [True, False])
@pytest.mark.slow
def test_results_are_the_same_with_and_without(plain, kernels):
    fast = in_a_process(JAXCLEAR_PLAIN_LOOPS="0" if kernels else "1")
    assert "small_while_loop" in fast["flags"] and plain["flags"] == ""
    # Without wear: outside kernels surfaces are updated at saving times alone. Rounding differs
    # where operations are fused, and bounces multiply it: 1e-9 was seen after these steps.
    np.testing.assert_allclose(fast["states"], plain["states"], rtol=1e-6, atol=1e-8)


def test_flags_of_the_user_are_kept():
    own = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=2048"
    assert in_a_process("flags", XLA_FLAGS=own)["flags"] == own


def test_what_xla_goes_through_itself_is_optimised(monkeypatch):
    """Counted steps and loops without kernels: XLA then does much of a run's work."""
    rungs, scene = jc.integrator, jc.scenes.flap()
    assert is_all_kernel(scene, rungs.Adaptive())
    assert not is_all_kernel(scene, rungs.Adaptive(), loud=True)
    assert not is_all_kernel(scene, rungs.FixedStep(1e-5, steps_per_save=10))
    assert not is_all_kernel(scene, rungs.Adaptive(diffrax.Kvaerno5()))
    # Surfaces wear within the kernel.
    assert is_all_kernel(jc.scenes.parallel_3rsr(cells=(96, 96)), rungs.Adaptive())
    monkeypatch.setenv("JAXCLEAR_PLAIN_LOOPS", "1")
    assert not is_all_kernel(scene, rungs.Adaptive())
