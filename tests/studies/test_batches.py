"""A batch is its samples: each as it would run alone, and again bit for bit; and chunks side by
side never wait for each other."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.native import compiled, kernel, stops
from jaxclear.native.verdicts import calls_lapack
from jaxclear.studies.store import batch

# Orders of operations differ between a lane of a vector and a register by itself; over few steps
# rounding is all that comes of it.
ROUNDING = 1e-9
# Where an error control chooses the steps, their lengths carry it on (1.7e-9 of a worn volume).
ROUNDING_OF_STEPS = 1e-7
RUNGS = {
    "fixed": jc.integrator.FixedStep(1e-5),
    "on groups": jc.integrator.FixedStep(1e-5, "munthe_kaas4"),
    "implicit": jc.integrator.ImplicitStep(1e-4),
    "adaptive": jc.integrator.Adaptive(),
    "Moreau-Jean": jc.integrator.MoreauJean(1e-4),
    "non-colliding": jc.integrator.NonColliding(1e-4),
}


def at_parent(joint, axis):
    return lambda rig: rig.connections[joint].parent.at[axis]


# Scenes as every rung of the ladder takes them, and a length of a link in each.
SCENES = {
    "slider-crank": (lambda wear: jc.scenes.slider_crank(wear=wear), at_parent("B", 0)),
    "four-bar": (lambda wear: jc.scenes.four_bar(wear=wear), at_parent("A", 0)),
    "antenna": (lambda wear: jc.scenes.antenna(friction="regularised"), at_parent("J2", 2)),
    "guide": (lambda wear: jc.scenes.guide(friction="regularised"), at_parent("A", 0)),
}
QUICK = {("slider-crank", "implicit")}


def problem(scene, rung, duration=2e-3):
    make, length = SCENES[scene]
    ends = {"first": lambda run: run.states[-1, 0], "last": lambda run: run.states[-1, -1]}
    varied = {"length": jc.Variable(length, jc.distribution.Uniform(2e-3))}
    how = {"duration": duration, "integrator": RUNGS[rung], "save": 5}
    return jc.Problem(make(rung != "non-colliding"), ends, varied, **how)


def cases():
    return [
        pytest.param(s, r, marks=() if (s, r) in QUICK else pytest.mark.slow)
        for s in SCENES
        for r in RUNGS
    ]


@pytest.mark.parametrize(("scene", "rung"), cases())
def test_a_batch_equals_its_samples_and_a_sample_runs_again_bit_for_bit(scene, rung):
    question = problem(scene, rung)
    study = jc.monte_carlo(question, 11, chunk=8)
    assert len(study.failed) == 0
    alone = jax.jit(lambda values: question.evaluate(values).responses)
    near = ROUNDING_OF_STEPS if rung == "adaptive" else ROUNDING
    for index in (0, 5, 10):
        # Copies of the sample in the other lanes, and another program around its loop.
        run, found = study.rerun(index), alone(jnp.asarray(study.values[index]))
        assert run.succeeded
        for name, response in question.response.items():
            assert response(run) == study.responses[name][index]
            np.testing.assert_allclose(found[name], response(run), rtol=near)


class Fake:
    """In the place of a kernel where a program is only looked at."""

    number = 1


@pytest.mark.parametrize(("scene", "rung"), cases())
def test_chunks_call_no_lapack(scene, rung, monkeypatch):
    monkeypatch.setattr(kernel, "build", lambda *_: Fake())
    question = problem(scene, rung)
    values = jnp.tile(question.nominal(), (4, 1))
    text = batch.evaluate_chunk.lower(question, values).as_text()
    assert "lapack" not in text and "blas" not in text


def test_a_program_tells_whether_it_calls_lapack():
    solve = lambda matrix: jnp.linalg.solve(matrix, jnp.ones(3))
    matrices = jnp.eye(3) + jnp.ones((4, 3, 3))

    def told(function):
        return bool(jax.jit(lambda x: calls_lapack(jax.vmap(function)(x)))(matrices))

    assert told(solve) and told(jax.jit(solve))
    assert told(lambda x: jax.lax.fori_loop(0, 3, lambda _, b: jnp.linalg.solve(x, b), jnp.ones(3)))
    assert not told(lambda x: x @ jnp.ones(3))


def test_a_program_is_looked_up_once_and_gives_what_it_gives_among_others(monkeypatch):
    root = lambda a, b: {"root": jnp.sqrt(a) - b}
    varied = {"a": jc.Dimension(2.0, tolerance=0.1), "b": jc.Dimension(1.0, tolerance=0.1)}
    question = jc.FunctionProblem(root, varied)
    values = np.random.default_rng(0).uniform(1.0, 2.0, (12, 2))
    sought, own = [], compiled._find
    monkeypatch.setattr(compiled, "_find", lambda *given: sought.append(given) or own(*given))
    program = batch.Program(question)
    for piece in (values[:4], values[4:8], values[8:]):
        found, wanted = program.run(piece, stops()), batch.evaluate_chunk(question, piece)
        np.testing.assert_array_equal(found.responses["root"], wanted.responses["root"])
    assert len(sought) == 1 and not program.compiled(values[:4])
    solved = lambda a, b: {"root": jnp.linalg.solve(jnp.eye(3) + a, jnp.ones(3))[0] - b}
    assert batch.Program(jc.FunctionProblem(solved, varied)).compiled(values[:4])


SLIDER_CRANK = """
import jax
import jax.numpy as jnp
import jaxclear as jc
rig = jc.scenes.slider_crank(wear=False)

def solved(run):
    matrix = jnp.eye(18) * 3.0 + run.states[-1, 0] + jnp.outer(run.states[-1], run.states[-1])[0, 0]
    turn = lambda _, matrix: jnp.eye(18) * 3.0 + 0.1 * jnp.linalg.inv(matrix)
    return jax.lax.fori_loop(0, 50, turn, matrix)[0, 0]

varied = {"c": jc.Variable(lambda r: r.connections["B"].joint.clearance, tolerance=1e-6)}
step = jc.integrator.FixedStep(1e-5)
asked = jc.Problem(rig, solved, varied, duration=1e-4, integrator=step, save=3)
chunk = 64
"""
ANTENNA = """
import jaxclear as jc
rig = jc.scenes.antenna("spatial", friction="regularised")
arm = jc.Variable(lambda r: r.connections["J2"].parent.at[2], tolerance=1e-3)
step = jc.integrator.ImplicitStep(1e-4)
end = lambda run: run.states[-1, 0]
asked = jc.Problem(rig, end, {"arm": arm}, duration=1e-3, integrator=step, save=3)
chunk = None
"""
SAMPLE = """
for seed in range(5):
    study = jc.monte_carlo(asked, 256, chunk=chunk, seed=seed)
assert len(study.failed) == 0
print("ended")
"""


@pytest.mark.slow
@pytest.mark.parametrize("problem", [SLIDER_CRANK, ANTENNA], ids=["slider-crank", "antenna"])
def test_chunks_do_not_wait_for_each_other(problem):
    """Two at once whose responses call LAPACK, each in a thread of XLA's pool, waited for ever."""
    command = [sys.executable, "-c", problem + SAMPLE]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.stdout == "ended\n", done.stderr[-2000:]
