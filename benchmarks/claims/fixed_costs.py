"""What a run costs beside its steps: a sample of a study by the size of its chunks and by how often
it is saved, with steps and without (a run of no length, which takes one step of no length for each
saving time); and a call of `simulate`, of the same numbers and of others each time, and of
`Problem.evaluate`, as a loop of SciPy's makes them; and what a film costs in a batch.

CPU time, all in one process, the cases taking turns; of samples also as a share of what the
smallest chunks take.
"""

import functools
import itertools
import os
import tempfile
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import run_tables, side_by_side
from jaxclear.studies.store import batch

# Samples of a study, and chunks of them.
SAMPLES, CHUNKS = 2048, (64, 128, 256, 512, 1024)
DURATION, STEP = 0.01, jc.integrator.FixedStep(2e-5)
SCENES = {
    "slider-crank": jc.scenes.slider_crank,
    "slider-crank that wears": functools.partial(jc.scenes.slider_crank, wear=True),
    "four-bar": jc.scenes.four_bar,
}
# What varies: a length moves the start of every sample, a clearance does not.
VARIED = {
    "clearance": lambda rig: rig.connections["B"].joint.clearance,
    "length": lambda rig: rig.connections["B"].parent.at[0],
}
# Scene, what varies, saving times, and whether it has no length.
STUDIES = (
    ("slider-crank", "clearance", 3, True),
    ("slider-crank", "clearance", 3, False),
    ("slider-crank", "clearance", 201, True),
    ("slider-crank", "clearance", 201, False),
    ("slider-crank", "length", 3, True),
    ("slider-crank that wears", "clearance", 51, False),
    ("four-bar", "clearance", 51, False),
    ("four-bar", "length", 51, False),
)
TURNS, CALLS = 7, 40
FILMS = {"none": None} | {
    name: getattr(jc.film, name)(viscosity=0.01)
    for name in ("ShortHalfFilm", "HalfFilm", "Reynolds")
}


def problem(scene: str, varied: str, saves: int, idle: bool = False) -> jc.Problem:
    variable = jc.Variable(VARIED[varied], tolerance=20e-6)
    asked = jc.Problem(
        SCENES[scene](),
        jc.response.MeanContactForce("B"),
        {varied: variable},
        duration=DURATION,
        save=saves,
        integrator=STEP,
    )
    return asked.with_experiment(asked.cost().idle) if idle else asked


def smallest(cases: dict[Any, Callable[[], Any]], turns: int) -> dict[Any, float]:
    """CPU seconds of each case."""
    return {name: cpu for name, (_, cpu) in side_by_side(cases, turns).items()}


def sample_row(scene: str, varied: str, saves: int, idle: bool, turns: int) -> dict[str, Any]:
    """CPU microseconds a sample, by the size of chunks."""
    asked = problem(scene, varied, saves, idle)
    spread = np.random.default_rng(0).uniform(-2e-5, 2e-5, size=(SAMPLES, 1))
    values = np.asarray(asked.nominal()) + spread
    cases = {n: functools.partial(batch.evaluate_all, asked, values, chunk=n) for n in CHUNKS}
    spent = smallest(cases, turns)
    row: dict[str, Any] = {"scene": scene, "varied": varied, "saves": saves}
    row["steps"] = "none" if idle else 500
    row |= {f"chunks of {n} [us/sample]": 1e6 * spent[n] / SAMPLES for n in CHUNKS}
    row["taken"] = batch.usual_batch(asked)
    row["taken over the smallest"] = spent[row["taken"]] / spent[CHUNKS[0]]
    return row


def call_rows(turns: int) -> list[dict[str, Any]]:
    """CPU milliseconds of a call that hardly takes a step, beside one that takes 500."""
    rig, asked = jc.scenes.slider_crank(), problem("slider-crank", "clearance", 3)
    short = asked.with_experiment(asked.cost().idle)
    values = asked.nominal()
    run = functools.partial(jc.simulate, integrator=STEP, save=3, verify=False)
    clearance = lambda of: of.connections["B"].joint.clearance
    # More than `simulate` remembers.
    sizes = np.linspace(1e-4, 2e-4, 2 * CALLS)
    others = itertools.cycle([eqx.tree_at(clearance, rig, jnp.asarray(each)) for each in sizes])
    calls = {
        "simulate": (lambda: run(rig, 4e-5), lambda: run(rig, DURATION)),
        "simulate, each time another clearance": (
            lambda: run(next(others), 4e-5),
            lambda: run(next(others), DURATION),
        ),
        "Problem.evaluate": (lambda: short.evaluate(values), lambda: asked.evaluate(values)),
    }
    cases = {
        (name, i): functools.partial(_often, call)
        for name, pair in calls.items()
        for i, call in enumerate(pair)
    }
    spent = smallest(cases, turns)
    return [
        {
            "call": name,
            "hardly a step [ms]": 1e3 * spent[name, 0] / CALLS,
            "500 steps [ms]": 1e3 * spent[name, 1] / CALLS,
        }
        for name in calls
    ]


def film_problem(film: Any) -> jc.Problem:
    """A journal pressed down and turned in its bearing, its clearance varied."""
    gap = jc.clearance.PlanarJournalBearing(
        jc.contact.CarvalhoMartins(), bearing_radius=1e-2, clearance=2e-4, length=2e-2, film=film
    )
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(gap, "ground", "journal")},
        {"gravity": jc.load.Gravity()},
        speeds={"journal": (0.0, 0.0, 100.0)},
    )
    clearance = jc.Variable(VARIED["clearance"], tolerance=20e-6)
    place = lambda run: run.body("journal").com[-1, 1]
    how = {"duration": DURATION, "save": 3, "integrator": STEP}
    return jc.Problem(rig, {"place": place}, {"clearance": clearance}, **how)


def film_rows(turns: int) -> list[dict[str, Any]]:
    """CPU nanoseconds of a Runge-Kutta step of a journal with a film in a batch of runs, that of a
    run of no length taken off; and of an evaluation of the film, of which a step has four."""
    values = 2e-4 + np.random.default_rng(0).uniform(-2e-5, 2e-5, size=(SAMPLES, 1))
    cases: dict[Any, Callable[[], Any]] = {}
    for name, film in FILMS.items():
        moving = film_problem(film)
        still = moving.with_experiment(moving.cost().idle)
        cases[name, True] = functools.partial(batch.evaluate_all, moving, values)
        cases[name, False] = functools.partial(batch.evaluate_all, still, values)
    spent, steps = smallest(cases, turns), SAMPLES * round(DURATION / float(STEP.step))
    step = {name: 1e9 * (spent[name, True] - spent[name, False]) / steps for name in FILMS}
    return [
        {
            "film": name,
            "an rk4 step [ns]": step[name],
            "an evaluation of the film [ns]": (step[name] - step["none"]) / 4 if film else None,
        }
        for name, film in FILMS.items()
    ]


def _often(call: Callable[[], Any]) -> Any:
    return [call() for _ in range(CALLS)]


def sample_rows(options: Any) -> list[dict[str, Any]]:
    studies = STUDIES[:2] if options.quick else STUDIES
    return [sample_row(*study, turns_of(options)) for study in studies]


def turns_of(options: Any) -> int:
    return 2 if options.quick else TURNS


TABLES = {
    "A call": lambda options: call_rows(turns_of(options)),
    "A sample of a study": sample_rows,
    "A film in a batch": lambda options: film_rows(turns_of(options)),
}

if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        os.environ["JAXCLEAR_CACHE"] = folder
        run_tables(TABLES)
