"""What JAX makes of a run is right or says why: every cell of the book's table on derivatives,
against differences; of each row by both entry points."""

import functools
import re
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.scenes.slider_crank import bearing

PAGE = Path(__file__).parents[2] / "notebooks/derivatives.md"
SAVES = 5
# (joint, worn, step [s], duration [s]) by a word of the table.
CASES = {
    "ideal": (False, False, 1e-3, 0.1),
    "permanent contact": (True, False, 1e-3, 0.1),
    "permanent contact, worn": (True, True, 1e-3, 0.1),
    "opening and closing": (True, False, 2e-5, 4e-3),
    "opening, closing and worn": (True, True, 2e-5, 4e-3),
    "the same": (True, False, 2e-5, 4e-3),
    "the same and worn": (True, True, 2e-5, 4e-3),
}
ENTRIES = ("evaluate", "simulate")
DISCRETE = ", `discrete_derivatives=True`"


def rows():
    """(joints, integrator, [(transformations, word)]) of each row."""
    lines = [line for line in PAGE.read_text().splitlines() if line.startswith("|")]
    lines = lines[next(i for i, line in enumerate(lines) if "`hessian`" in line) :]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    names = [re.findall(r"`(\w+)`", each) for each in cells[0][2:]]
    for joints, integrator, *words in cells[2:]:
        yield joints, integrator.strip("`"), list(zip(names, words, strict=True))


def cells():
    """Each cell by one of its transformations and one entry point, in turn: a row has one mode by
    one and the other by the other, and of two rows with one entry in a column one has `jvp` (or
    `grad`), the next `jacfwd` (or `jacrev`)."""
    for i, (joints, integrator, told) in enumerate(rows()):
        for j, (names, word) in enumerate(told):
            entry = "evaluate" if DISCRETE in joints else ENTRIES[(i + j) % 2]
            yield joints, integrator, names[i // 2 % len(names)], word, entry


def integrator_of(text: str, step: float, duration: float) -> AbstractIntegrator:
    known = {name: getattr(jc.integrator, name) for name in jc.integrator.__all__}
    known |= {"Kvaerno5": diffrax.Kvaerno5, "h": step}
    return eval(text, known | {"n": round(duration / step / (SAVES - 1))})


@functools.cache
def problem(joints: str, text: str) -> jc.Problem:
    """A rod swings about a pin, or rests in a bearing that it leaves within the run."""
    clear, worn, step, duration = CASES[joints.removesuffix(DISCRETE)]
    joint = bearing(1e-5, None, True, worn) if clear else jc.joint.Revolute()
    rig = jc.Mechanism(
        {"rod": jc.Body(1.0, 1e-2, (0.5, 0.0))},
        {"B": jc.Connection(joint, "ground", "rod")},
        {"gravity": jc.load.Gravity((0.0, -9.81))},
        start={"B": -np.pi / 2 + 0.3},
    )
    length = jc.Variable(lambda r: r.bodies["rod"].com[0], tolerance=0.01)
    mass = jc.Variable(lambda r: r.bodies["rod"].mass, tolerance=0.01)
    place = lambda run: 1e3 * jnp.sum(run.body("rod").com[-1, :2])
    how = {"integrator": integrator_of(text, step, duration), "save": SAVES}
    return jc.Problem(rig, place, {"length": length, "mass": mass}, duration=duration, **how)


def answer_of(asked: jc.Problem, entry: str, discrete: bool):
    if entry == "evaluate":
        return lambda v: asked.evaluate(v, discrete_derivatives=discrete).responses["response"]

    def simulated(values):
        how = {"integrator": asked.integrator, "save": SAVES, "throw": False}
        run = jc.simulate(asked.with_values(values), asked.duration, **how)
        return asked.response["response"](run)

    return simulated


TRANSFORMATIONS = {
    "jvp": lambda f, x: jax.vmap(lambda way: jax.jvp(f, (x,), (way,))[1])(jnp.eye(2)),
    "jacfwd": lambda f, x: jax.jacfwd(f)(x),
    "grad": lambda f, x: jax.grad(f)(x),
    "jacrev": lambda f, x: jax.jacrev(f)(x),
    "hessian": lambda f, x: jax.hessian(f)(x),
}


def differences(function, x, share):
    steps = share * x[:, None] * jnp.eye(2)
    both = jax.vmap(function)(jnp.concatenate([x + steps, x - steps]))
    return (both[:2] - both[2:]) / (2 * share * x).reshape(2, *[1] * (both.ndim - 1))


@functools.cache
def reference(joints: str, text: str, second: bool, share: float):
    """First or second derivatives by differences."""
    problem_of_row = problem(joints, text)
    function = answer_of(problem_of_row, "evaluate", True)
    if second:
        function = jax.jacfwd(function)
    return jax.jit(lambda v: differences(function, v, share))(problem_of_row.nominal())


def assert_cell(joints, text, name, word, entry):
    asked = problem(joints, text)
    x = asked.nominal()
    answer = answer_of(asked, entry, DISCRETE in joints)
    if word == "says why":
        ways = (
            r"jaxclear.sensitivity|take forward mode \(jax.jvp, jax.jacfwd|"
            "take differences of first derivatives"
        )
        with pytest.raises(ValueError, match=ways):
            jax.jit(lambda v: TRANSFORMATIONS[name](answer, v))(x)
        return
    some = x * jnp.array([[1.0], [1.01]])
    if name == "vmap":
        alone = jax.jit(answer)
        found = jax.jit(jax.vmap(answer))(some)
        np.testing.assert_allclose(found, [alone(each) for each in some], rtol=1e-9)
        return
    found = jax.jit(lambda v: TRANSFORMATIONS[name](answer, v))(x)
    # Tangents of `Adaptive` are not in its error control; second differences lose digits.
    # Of equal steps through contacts those of the motion, which `Adaptive` follows.
    equal = text.startswith(("FixedStep", "MoreauJean", "ImplicitStep"))
    steps = word == "right" and joints.startswith("opening") and equal
    # Slopes of a discrete run bend wherever a touch moves into another step: over 1e-7 of a
    # variable one still does, in steps that contacts halve; below 1e-8 rounding takes digits.
    share = 3e-8 if name == "hessian" and word == "discrete" else 1e-5
    wanted = reference(joints, "Adaptive()" if steps else text, name == "hessian", share)
    close, small = 2e-3 if steps else 1e-5, 1e-5 * np.abs(wanted).max()
    if steps and text.startswith("MoreauJean"):
        # A slope so small beside the other is off by a third of itself, and refused; of `simulate`
        # a state's slope that is not known makes what is formed from it nan.
        refused = (abs(wanted) <= small) | (entry == "simulate")
        found = np.where(np.isnan(found) & refused, wanted, found)
    np.testing.assert_allclose(found, wanted, rtol=close, atol=small)


@pytest.mark.slow
@pytest.mark.parametrize("cell", list(cells()), ids=lambda cell: " ".join((*cell[:3], cell[4])))
def test_every_cell_of_the_books_table_holds(cell):
    assert_cell(*cell)


def test_the_books_table_names_every_integrator_and_entry():
    named = {text.split("(")[0] for _, text, _ in rows()}
    family = {name for name in jc.integrator.__all__ if is_integrator(name)}
    assert named == family
    words = {word for *_, told in rows() for _, word in told}
    assert words == {"right", "discrete", "says why"}


def is_integrator(name):
    own = getattr(jc.integrator, name)
    return isinstance(own, type) and own in AbstractIntegrator.__subclasses__()
