"""Every joint, worn or not, has a kernel on every rung that takes it, with the jax that is
installed, with the lowest that is allowed and with the newest.

One primitive without a rule, and a run takes ten times as long without a word: the derivative of
`stack` became such a one with a new jax. Kernels are written as text, and most of them compared
with JAX, turn by turn; that they run is of every other test."""

import os
import re
import subprocess
import sys
from functools import partial
from importlib import metadata
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

import jaxclear as jc
from jaxclear.multibody.assembly import assemble_arrays
from jaxclear.native import check, kernel
from jaxclear.native.verdicts import only_kernels
from jaxclear.simulation.simulate import check_run, run
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
# Rungs whose kernels differ from those above them in operations that no joint takes part in (how
# coordinates go on, how an error decides on a step) or that all joints share (how a gap shortens a
# step), and with which joints.
VARIANTS = {
    "on groups": ("planar", "ball"),
    "adaptive": ("planar_conformal", "journal_with_collars", "guide"),
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


# Loops that have passed their check: many rungs share those that wear a surface.
PASSED = set()


def write(program, lanes):
    kernel.text_of(program, lanes)


def compare(program, lanes):
    """As with JAXCLEAR_CHECK_KERNELS=1; of a loop that random numbers do not end or compare
    conclusively, the loops within it."""
    text = kernel.text_of(program, lanes, checked=True)
    if text in PASSED:
        return
    try:
        check.check(program, kernel.turn_of(program, lanes), partial(check.turn_by_jax, program))
    except check.Incomparable:
        for equation in program.body.jaxpr.eqns:
            if equation.primitive.name == "jaxclear_loop":
                compare(equation.params["program"], lanes)
    PASSED.add(text)


def kernels_of(rig, integrator, judge, monkeypatch):
    """The loops of a run, each of which becomes a kernel that passes; none is compiled for it."""
    passed, failed = [], []

    def build(program, lanes, _):
        try:
            judge(program, lanes)
        except Exception as reason:
            failed.append(repr(reason))
            raise
        passed.append(program)
        return SimpleNamespace(number=0)

    monkeypatch.setattr(kernel, "build", build)
    mechanism = integrator.formulation.modelled(rig)

    def everything():
        start = assemble_arrays(mechanism)
        whole = run(mechanism, start.coordinates, start.speeds, TIMES, integrator)
        return eqx.filter(whole, eqx.is_array)

    with only_kernels():
        jax.jit(everything).lower()
    assert passed and not failed
    return passed


@pytest.mark.parametrize(
    ("joint", "rung"), CELLS if OTHER_JAX in os.environ else [("ball", "implicit")]
)
def test_a_kernel_can_be_written(joint, rung, monkeypatch):
    rig, integrator = build(joint, USUAL), RUNGS[rung]
    if not refused(rig, integrator):
        kernels_of(rig, integrator, write, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize(("joint", "rung"), CELLS)
def test_the_kernel_passes_its_check(joint, rung, monkeypatch):
    rig = build(joint, USUAL)
    if not refused(rig, RUNGS[rung]):
        passed = kernels_of(rig, RUNGS[rung], compare, monkeypatch)
        # Where surfaces wear, a turn from one saving time to the next.
        assert any(one.length == 1 for one in passed) or joint != "journal_that_wears"


SCENE_RUNGS = ("fixed", "implicit", "Moreau-Jean", "non-colliding", "adaptive")


@pytest.mark.slow
@pytest.mark.parametrize("name", jc.scenes.__all__)
def test_every_scene_has_a_kernel(name, monkeypatch):
    """Each on every rung; on two of them, in turn, compared with JAX as well."""
    given = {"antenna": {"friction": "regularised"}, "guide": {"friction": "regularised"}}
    rig, first = getattr(jc.scenes, name)(**given.get(name, {})), jc.scenes.__all__.index(name)
    for i, rung in enumerate(SCENE_RUNGS):
        if not refused(rig, RUNGS[rung]):
            judge = compare if (i - first) % len(SCENE_RUNGS) in (0, 2) else write
            kernels_of(rig, RUNGS[rung], judge, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("rung", SCENE_RUNGS)
def test_loops_that_leave_nothing_free_have_a_kernel(rung, monkeypatch):
    """Two spatial loops, every drive prescribed: the closures' matrix is square, and singular for
    most numbers."""
    rig = jc.scenes.parallel_3rsr("ideal", period=1.0)
    kernels_of(rig, RUNGS[rung], compare, monkeypatch)


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
    (there,) = (d.version for d in metadata.distributions(name="jax", path=[str(tmp_path)]))
    if there == jax.__version__:
        pytest.skip(f"jax {there} is the one that is installed, of which are all other tests")
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]),
        OTHER_JAX: "1",
    }
    tests = [__file__, os.path.join(os.path.dirname(__file__), "test_rules.py")]
    command = [sys.executable, "-m", "pytest", "-n", "0", "-q", "-k", "written or rule", "-m", ""]
    how = {"env": environment, "capture_output": True, "text": True, "timeout": 1200}
    done = subprocess.run([*command, *tests], **how)
    assert done.returncode == 0, done.stdout[-3000:]
