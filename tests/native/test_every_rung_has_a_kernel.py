"""Every joint, worn or not, has a kernel on every rung that takes it, with the jax that is
installed, with the lowest that is allowed and with the newest.

One primitive without a rule, and a run takes ten times as long without a word: the derivative of
`stack` became such a one with a new jax. In the quick test kernels are written as text alone,
neither compiled nor run; the slow one compiles, checks and runs them. With another jax all are
written as text."""

import os
import re
import subprocess
import sys
import warnings
from importlib import metadata

import jax
import jax.numpy as jnp
import pytest

import jaxclear as jc
from jaxclear.multibody.assembly import assemble_arrays
from jaxclear.native import kernel
from jaxclear.native.verdicts import KERNELS
from jaxclear.native.writer import Unsupported
from jaxclear.simulation.simulate import check_run, run
from tests.rigs.cells import slow
from tests.rigs.clearance_joints import JOINTS, USUAL, build

RUNGS = {
    "fixed": jc.integrator.FixedStep(),
    "fixed, short steps in contact": jc.integrator.FixedStep(1e-4, contact_steps=5.0),
    "on groups": jc.integrator.FixedStep(method="munthe_kaas4"),
    "implicit": jc.integrator.ImplicitStep(),
    "adaptive": jc.integrator.Adaptive(),
    "adaptive on groups": jc.integrator.Adaptive(jc.integrator.MuntheKaas()),
    "Moreau-Jean": jc.integrator.MoreauJean(),
    "non-colliding": jc.integrator.NonColliding(),
}
# That a run in the plane has no kernel is an error in every test.
QUICK = [("ball", "implicit"), *slow(("ball", "Moreau-Jean"), ("journal_that_wears", "fixed"))]
# Rungs whose kernels differ from those above them in operations that no joint takes part in (how
# coordinates go on) or that all joints share (how a gap shortens a step), and with which joints.
VARIANTS = {
    "on groups": ("planar", "ball"),
    "adaptive on groups": ("planar", "journal_that_wears"),
    "fixed, short steps in contact": ("planar", "ball", "guide"),
}
CELLS = [(j, r) for j in JOINTS for r in RUNGS if j in VARIANTS.get(r, JOINTS)]
# Set where these tests run with another jax.
OTHER_JAX = "JAXCLEAR_TEST_WITH_OTHER_JAX"
TIMES = jnp.linspace(0.0, 1e-3, 3)
# What a rung refuses by a sentence asks for no kernel: restitutions that depend on the speed in
# MoreauJean, worn joints and rubbing balls in NonColliding.
REFUSALS = "restitution|wears|no form in permanent contact"


def refused(rig, integrator):
    try:
        check_run(rig, integrator)
        integrator.formulation.modelled(rig)
    except ValueError as sentence:
        assert re.search(REFUSALS, str(sentence)), sentence
        return True
    return False


@pytest.mark.parametrize(
    ("joint", "rung"), [(j, r) for j in JOINTS for r in RUNGS] if OTHER_JAX in os.environ else QUICK
)
def test_a_kernel_can_be_written(joint, rung, monkeypatch):
    rig, integrator, written = build(joint, USUAL), RUNGS[rung], []
    if refused(rig, integrator):
        return

    def write(program, lanes, _):
        kernel.text_of(program, lanes)
        written.append(program)
        raise Unsupported("a test")

    monkeypatch.setattr(kernel, "build", write)
    mechanism = integrator.formulation.modelled(rig)

    def states():
        start = assemble_arrays(mechanism)
        return run(mechanism, start.coordinates, start.speeds, TIMES, integrator).states

    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        jax.jit(states).lower()
    missing = [str(w.message) for w in said if "machine code" in str(w.message)]
    assert written and not [m for m in missing if "a test" not in m]
    # Where surfaces wear, a turn from one saving time to the next.
    assert any(program.length == 1 for program in written) or joint != "journal_that_wears"


@pytest.mark.slow
@pytest.mark.parametrize(("joint", "rung"), CELLS)
def test_the_kernel_passes_its_check_and_runs(joint, rung, checked):
    rig = build(joint, USUAL)
    if refused(rig, RUNGS[rung]):
        return
    found = jc.simulate(rig, 1e-4, save=3, integrator=RUNGS[rung], throw=False)
    assert found.stats.loops == KERNELS


@pytest.mark.slow
@pytest.mark.parametrize("name", jc.scenes.__all__)
def test_every_scene_has_a_kernel(name, checked):
    scene = getattr(jc.scenes, name)
    given = {"antenna": {"friction": "regularised"}, "guide": {"friction": "regularised"}}
    for integrator in (RUNGS[rung] for rung in RUNGS if rung not in VARIANTS):
        rig = scene(**given.get(name, {}))
        if not refused(rig, integrator):
            found = jc.simulate(rig, 1e-4, save=3, integrator=integrator, throw=False)
            assert found.stats.loops == KERNELS


@pytest.mark.slow
@pytest.mark.parametrize("rung", ["fixed", "implicit", "adaptive", "Moreau-Jean", "non-colliding"])
def test_loops_that_leave_nothing_free_have_a_kernel(rung, checked):
    """Two spatial loops, every drive prescribed: the closures' matrix is square, and singular for
    most numbers."""
    rig = jc.scenes.parallel_3rsr("ideal", period=1.0)
    assert jc.simulate(rig, 1e-3, save=3, integrator=RUNGS[rung]).stats.loops == KERNELS


def allowed():
    """The lowest jax that this package allows, and the newest there is (None)."""
    (bound,) = (r for r in metadata.requires("jaxclear") or [] if re.match(r"jax\b[^l]", r))
    return [re.search(r">=\s*([\d.]+)", bound)[1], None]


@pytest.mark.slow(sample=False)
@pytest.mark.parametrize("newest", [False, True], ids=["lowest", "newest"])
def test_with_every_jax_that_is_allowed(newest, tmp_path):
    """Kernels of all joints and each rule by itself, with another jax in front of the path."""
    version = allowed()[newest]
    wanted = [f"{name}=={version}.*" if version else name for name in ("jax", "jaxlib")]
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", str(tmp_path)]
    if subprocess.run([*pip, *wanted], capture_output=True, timeout=600).returncode:
        pytest.skip("the package registry cannot be reached")
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]),
        OTHER_JAX: "1",
    }
    tests = [__file__, os.path.join(os.path.dirname(__file__), "test_rules.py")]
    command = [sys.executable, "-m", "pytest", "-n", "0", "-q", "-k", "written or rule", "-m", ""]
    how = {"env": environment, "capture_output": True, "text": True, "timeout": 1200}
    done = subprocess.run([*command, *tests], **how)
    assert done.returncode == 0, done.stdout[-3000:]
