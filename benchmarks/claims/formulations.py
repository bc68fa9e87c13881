"""One mechanism, three formulations: what a step, a run and a sample of a batch cost at equal
accuracy of statistics.

Slider-crank and four-bar with one clearance joint, the antenna with two, each on compliant contact,
on rigid contact (MoreauJean) and with joints that always touch (NonColliding), friction laws the
same. Statistics are means over a few nearly equal runs. Each formulation is judged by itself: the
coarsest step whose means, and those of all finer ones tried, are within the accuracy of its own
finest reference. Then what the formulation itself is off by: its reference against the compliant
one. Cost: a step, a run alone (wall), and CPU time of a sample in a batch. Compilation is not
counted.
"""

import time
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import alone, arguments, report, sign
from jaxclear.integrators import Outcome
from jaxclear.scenes.antenna import BASE, JOINTS, TIP, antenna
from jaxclear.scenes.four_bar import four_bar
from jaxclear.studies.store.batch import evaluate_all

ACCURACY = 0.02
STEPS, CHEAPEST = "steps", "sample of a batch, CPU [ms]"
# Samples a chunk: that of studies on a CPU.
CHUNK = 64
# Clearances of the members differ by up to this share, enough for rattling paths to have nothing in
# common; those of a batch by up to this one.
SPREAD, BATCH_SPREAD = 2e-2, 0.05
# Friction of the antenna as a function of speed: full beyond a tenth of the sliding speeds.
ANTENNA_FRICTION = {"mu_kinetic": 0.1, "transition_speed": 1e-3}


class Ladder(NamedTuple):
    """Rungs from coarse to fine, their reference (None: that of the ladder before), and how often a
    run is saved: no more often than the longest step, but often where a mean is one of instants."""

    rungs: list
    reference: Any
    saves: int


class Scene(NamedTuple):
    """A problem, and its ladders by name."""

    problem: jc.Problem
    ladders: dict[str, Ladder]


def clearances(names: tuple[str, ...]):
    return lambda rig: [rig.connections[name].joint.clearance for name in names]


def crank_scene(quick: bool) -> Scene:
    kinds = jc.integrator
    responses = {
        "mean force": jc.response.MeanContactForce("B"),
        "slider": rms_speed("G"),
        STEPS: steps_of,
    }
    variables = {"clearance": jc.Variable(clearances(("B",)), tolerance=1e-6)}
    turns = 1 if quick else 4
    problem = jc.Problem(jc.scenes.slider_crank(), responses, variables, duration=0.125664 * turns)
    adaptive = lambda rtol: kinds.Adaptive(rtol=rtol, atol=1e-2 * rtol)
    ladders = {
        "Adaptive": Ladder(
            [adaptive(r) for r in (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)], adaptive(1e-9), 1000 * turns + 1
        ),
        "FixedStep semi-implicit": Ladder(
            [kinds.FixedStep(h, "semi_implicit") for h in (5e-5, 2e-5, 1e-5)],
            None,
            1000 * turns + 1,
        ),
        "ImplicitStep": Ladder(
            [kinds.ImplicitStep(h) for h in (1e-4, 5e-5, 2e-5, 1e-5)], None, 1000 * turns + 1
        ),
        "MoreauJean": Ladder(
            [kinds.MoreauJean(h) for h in (1e-3, 5e-4, 2e-4, 1e-4, 5e-5)],
            kinds.MoreauJean(5e-6),
            125 * turns + 1,
        ),
        "NonColliding": Ladder(
            [kinds.NonColliding(h) for h in (2e-3, 1e-3, 5e-4, 2e-4)],
            kinds.NonColliding(2e-5),
            62 * turns + 1,
        ),
    }
    return Scene(problem, ladders)


def four_bar_scene(quick: bool) -> Scene:
    kinds = jc.integrator
    rig = four_bar("spatial", wear=False)
    # The same coefficient, acting from small speeds on: rigid formulations know no speeds.
    law = jc.friction.CoulombTanh(
        mu_kinetic=rig.connections["B"].joint.friction.mu_kinetic, transition_speed=1e-2
    )
    rig = eqx.tree_at(lambda m: m.connections["B"].joint.friction, rig, law)
    responses = {
        "mean force": jc.response.MeanContactForce("B"),
        "follower": rms_spin("follower"),
        STEPS: steps_of,
    }
    variables = {"clearance": jc.Variable(clearances(("B",)), tolerance=1e-6)}
    turns = 1 if quick else 2
    problem = jc.Problem(rig, responses, variables, duration=0.628319 * turns)
    adaptive = lambda rtol: kinds.Adaptive(rtol=rtol, atol=1e-2 * rtol)
    ladders = {
        "Adaptive": Ladder(
            [adaptive(r) for r in (1e-3, 1e-4, 1e-5, 1e-6)], adaptive(1e-8), 1000 * turns + 1
        ),
        "FixedStep semi-implicit": Ladder(
            [kinds.FixedStep(h, "semi_implicit") for h in (4e-5, 2e-5, 1e-5, 5e-6, 2e-6)],
            None,
            1000 * turns + 1,
        ),
        "ImplicitStep": Ladder(
            [kinds.ImplicitStep(h) for h in (2e-4, 1e-4, 5e-5, 2e-5, 1e-5, 5e-6)],
            None,
            1000 * turns + 1,
        ),
        "MoreauJean": Ladder(
            [kinds.MoreauJean(h) for h in (1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5)],
            kinds.MoreauJean(5e-6),
            628 * turns + 1,
        ),
        "NonColliding": Ladder(
            [kinds.NonColliding(h) for h in (1e-2, 5e-3, 2e-3, 1e-3)],
            kinds.NonColliding(5e-5),
            63 * turns + 1,
        ),
    }
    return Scene(problem, ladders)


def antenna_scene(quick: bool) -> Scene:
    kinds = jc.integrator
    responses = {
        "mean force": jc.response.MeanContactForce("J1"),
        "link 1": rms_spin("link1"),
        "pointing": jc.response.PointingAngle(TIP, BASE),
        STEPS: steps_of,
    }
    variables = {"clearance": jc.Variable(clearances(JOINTS), tolerance=1e-6)}
    rig = antenna(friction=jc.friction.CoulombTanh(**ANTENNA_FRICTION))
    seconds = 1 if quick else 2
    problem = jc.Problem(rig, responses, variables, duration=seconds)
    steps = (4e-4, 2e-4, 1e-4, 5e-5, 2e-5)
    ladders = {
        "ImplicitStep": Ladder(
            [kinds.ImplicitStep(h) for h in steps], kinds.ImplicitStep(5e-6), 1000 * seconds + 1
        ),
        "MoreauJean": Ladder(
            [kinds.MoreauJean(h) for h in (2e-3, 1e-3, 5e-4, *steps[1:4])],
            kinds.MoreauJean(2e-5),
            500 * seconds + 1,
        ),
        "NonColliding": Ladder(
            [kinds.NonColliding(h) for h in (1e-2, 5e-3, 2e-3, 1e-3)],
            kinds.NonColliding(2e-4),
            100 * seconds + 1,
        ),
    }
    return Scene(problem, ladders)


SCENES = {"slider-crank": crank_scene, "four-bar": four_bar_scene, "antenna": antenna_scene}


def steps_of(run):
    return 1.0 * jnp.sum(run.accepted_steps)


def rms_speed(name: str):
    """Root mean square speed of a joint's coordinate."""
    return lambda run: jnp.sqrt(jnp.mean(run.speed(name) ** 2))


def rms_spin(body: str):
    """Root mean square angular velocity of a body."""
    return lambda run: jnp.sqrt(jnp.mean(jnp.sum(run.body(body).spin ** 2, axis=-1)))


def posed(problem: jc.Problem, integrator: Any, saves: int) -> jc.Problem:
    return eqx.tree_at(
        lambda p: (p.integrator, p.shares), problem, (integrator, jnp.linspace(0.0, 1.0, saves))
    )


def means_of(problem: jc.Problem, values: np.ndarray) -> dict[str, tuple[float, float]] | None:
    """Mean and standard error of every response over the members; None where a run was lost."""
    found = evaluate_all(problem, jnp.asarray(values))
    if not np.all(found.outcome == Outcome.REACHED):
        return None
    return {
        k: (float(np.mean(x)), float(np.std(x, ddof=1) / np.sqrt(len(x))))
        for k, x in found.responses.items()
    }


def off(found: dict, wanted: dict) -> tuple[str, float, float]:
    """Response whose means differ most, the difference and its standard error, as shares of the
    wanted mean.
    """
    rows = []
    for name in set(found) - {STEPS}:
        (mean, doubt), (known, known_doubt) = found[name], wanted[name]
        rows.append(
            (name, abs(mean - known) / abs(known), float(np.hypot(doubt, known_doubt)) / abs(known))
        )
    return max(rows, key=lambda row: row[1])


def cost(problem: jc.Problem, steps: float, samples: int) -> dict[str, float]:
    """Time of a step and of a run alone, and of a sample in a batch."""
    best, value = alone(problem, 3)[1], problem.nominal()
    rng = np.random.default_rng(0)
    batch = np.asarray(value) * (1 + BATCH_SPREAD * rng.uniform(-1, 1, (samples, np.size(value))))
    evaluate_all(problem, jnp.asarray(batch[:CHUNK]), chunk=CHUNK)
    start = time.process_time()
    evaluate_all(problem, jnp.asarray(batch), chunk=CHUNK)
    sample = (time.process_time() - start) / samples
    return {
        "step, CPU [us]": 1e6 * best / steps,
        "run, CPU [ms]": 1e3 * best,
        "sample of a batch, CPU [ms]": 1e3 * sample,
    }


def judge(scene: Scene, members: int, samples: int) -> list[dict[str, Any]]:
    """A row for each formulation: its coarsest step that is good enough, what that costs, and what
    the formulation is off by.
    """
    nominal = np.asarray(scene.problem.nominal())
    values = nominal * (1 + SPREAD * np.linspace(-1, 1, members))[:, None]
    reference = truth = None
    rows = []
    for name, (rungs, finest, saves) in scene.ladders.items():
        if finest is not None:
            reference = means_of(posed(scene.problem, finest, saves), values)
            truth = reference if truth is None else truth
        row: dict[str, Any] = {"integrator": name, "setting": "none"}
        row |= dict.fromkeys(
            ("error [%]", "standard error [%]", "step, CPU [us]", "run, CPU [ms]", CHEAPEST), np.nan
        )
        for rung in reversed(rungs):
            found = means_of(posed(scene.problem, rung, saves), values)
            if found is None:
                break
            _, error, doubt = off(found, reference)
            if error > max(ACCURACY, 2 * doubt):
                break
            setting = (
                f"rtol {float(rung.rtol):g}"
                if isinstance(rung, jc.integrator.Adaptive)
                else f"{float(rung.step):g} s"
            )
            row |= {"setting": setting, "error [%]": 100 * error, "standard error [%]": 100 * doubt}
            kept, steps = rung, found[STEPS][0]
        if row["setting"] != "none":
            row |= cost(posed(scene.problem, kept, saves), steps, samples)
        which, gap, doubt = off(reference, truth)
        row["formulation is off by [%]"] = (
            100 * gap if finest is not None and reference is not truth else 0.0
        )
        row["in"] = which if row["formulation is off by [%]"] else ""
        rows.append(row)
    return rows


def main() -> None:
    options = arguments(__doc__)
    members = 4 if options.quick else 16
    for name, make in SCENES.items():
        scene = make(options.quick)
        # What a sample costs is known from fewer of the antenna, whose rigid contacts are dear.
        samples = 128 if options.quick or name == "antenna" else 1024
        title = (
            f"{name}, {float(scene.problem.duration):g} s: within {100 * ACCURACY:g} % in its "
            "statistics"
        )
        report(title, judge(scene, members, samples), options)
    sign("benchmarks.claims.formulations", options.json)


if __name__ == "__main__":
    main()
