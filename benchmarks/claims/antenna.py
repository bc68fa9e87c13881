"""Sixty seconds of the antenna (spatial joints with Coulomb friction, periodic drive) on
NonColliding: what a run costs.

The step is chosen by the errors of the statistics against short steps: root mean square pointing
angle, mean normal force and mean friction of joint 1, and root mean square of its speed, as means
over a few antennas with slightly different friction. Its swing is shown but not counted: nothing
holds the joints at an angle, so where they have drifted to after a minute hangs on every stick.
Then the cost alone and a sample in a batch, and how still Coulomb's law holds joint 1 where a
regularised law creeps. Compilation is not counted.
"""

import time

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import alone, arguments, report, sign
from jaxclear.commands.antenna import friction_runs, friction_table
from jaxclear.integrators import Outcome
from jaxclear.scenes.antenna import BASE, HOLD, JOINTS, TIP, antenna
from jaxclear.studies.store.batch import cores, evaluate_all

SAVES_PER_SECOND = 20
STEPS = (1e-3, 2e-3, 5e-3, 1e-2, 2.5e-2)
REFERENCE = 2.5e-4
ACCURACY = 0.01
NOT_COUNTED = "swing"
# Friction coefficients of the ensemble differ by up to this share.
SPREAD = 0.02
# Samples a chunk: that of studies on a CPU.
CHUNK = 64
CLEARANCE_TOLERANCE, FRICTION_TOLERANCE = 20e-6, 0.01


def mean_friction(run):
    return jnp.mean(jnp.sum(run.contact("J1").traction, axis=-1))


def rms_speed(run):
    return jnp.sqrt(jnp.mean(run.speed("J1") ** 2))


def swing(run):
    angle = run.coordinate("J1")
    return jnp.max(angle) - jnp.min(angle)


def question(duration: float) -> jc.Problem:
    """The manoeuvre and its statistics; clearance and friction of both joints may vary."""
    return jc.Problem(
        antenna(),
        {
            "pointing": jc.response.PointingAngle(TIP, BASE),
            "mean force": jc.response.MeanContactForce("J1"),
            "mean friction": mean_friction,
            "rms speed": rms_speed,
            "swing": swing,
        },
        {
            "clearance": jc.Variable(
                lambda rig: [rig.connections[name].joint.clearance for name in JOINTS],
                tolerance=CLEARANCE_TOLERANCE,
            ),
            "friction": jc.Variable(
                lambda rig: [rig.connections[name].joint.friction.mu_kinetic for name in JOINTS],
                tolerance=FRICTION_TOLERANCE,
            ),
        },
        duration=duration,
        integrator=jc.integrator.NonColliding(),
        save=round(SAVES_PER_SECOND * duration) + 1,
    )


def with_step(problem: jc.Problem, step: float) -> jc.Problem:
    return eqx.tree_at(lambda p: p.integrator.step, problem, jnp.asarray(step))


def convergence(problem: jc.Problem, duration: float, members: int) -> list[dict]:
    """A row a step: errors of the means, and the cost alone."""
    nominal = np.asarray(problem.nominal())
    values = jnp.asarray(
        np.stack([nominal * [1.0, 1 + x] for x in SPREAD * np.linspace(-1, 1, members)])
    )
    wanted = evaluate_all(with_step(problem, REFERENCE), values).responses
    rows = []
    for step in STEPS:
        asked = with_step(problem, step)
        found = evaluate_all(asked, values)
        row, worst = {"step [s]": f"{step:g}"}, 0.0
        for key, reference in wanted.items():
            error = abs(np.mean(found.responses[key] - reference) / np.mean(reference))
            row[f"{key} [%]"] = 100 * float(error)
            worst = max(worst, 0.0 if key == NOT_COUNTED else float(error))
        wall, cpu = alone(asked, 3)
        row |= {"alone, wall [s]": wall, "alone, CPU [s]": cpu, "simulated / wall": duration / wall}
        sound = bool(np.all(found.outcome == Outcome.REACHED))
        row["within 1 %"] = (
            "yes" if sound and worst < ACCURACY else ("no" if sound else "did not reach its end")
        )
        rows.append(row)
    return rows


def batch(problem: jc.Problem, step: float, samples: int) -> dict:
    """Cost of a sample in a batch, clearance and friction varied within their tolerances."""
    rng = np.random.default_rng(0)
    tolerances = np.array([CLEARANCE_TOLERANCE, FRICTION_TOLERANCE])
    values = jnp.asarray(
        np.asarray(problem.nominal()) + tolerances * rng.uniform(-1, 1, (samples, 2))
    )
    asked = with_step(problem, step)
    chunk = min(CHUNK, -(-samples // cores()))
    evaluate_all(asked, values[:chunk], chunk=chunk)
    cpu, wall = time.process_time(), time.perf_counter()
    outcome = evaluate_all(asked, values, chunk=chunk)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    failed = int(np.sum(outcome.outcome != Outcome.REACHED))
    row = {"step [s]": f"{step:g}", "samples": samples, "failed": failed}
    return row | {"wall [ms/sample]": 1e3 * wall / samples, "CPU [ms/sample]": 1e3 * cpu / samples}


def main() -> None:
    options = arguments(__doc__)
    duration, members, samples = (6.0, 4, 64) if options.quick else (60.0, 8, 1024)
    problem = question(duration)
    rows = convergence(problem, duration, members)
    title = (
        f"antenna, {duration:g} s, NonColliding: means over {members} runs against {REFERENCE:g} "
        "s, and cost alone"
    )
    report(title, rows, options)
    # A step counts if all finer ones are good too; the finest is shown beside the longest.
    good = [
        step
        for k, step in enumerate(STEPS)
        if all(row["within 1 %"] == "yes" for row in rows[: k + 1])
    ]
    if good:
        found = [batch(problem, step, samples) for step in dict.fromkeys((good[-1], good[0]))]
        report(f"antenna, {duration:g} s: a batch on all cores", found, options)
    table = friction_table(friction_runs(HOLD)).to_dict("records")
    report(
        f"antenna, step drive, {HOLD:g} s: slip of joint 1 while Coulomb's law makes it stick",
        table,
        options,
    )
    sign("benchmarks.claims.antenna", options.json)


if __name__ == "__main__":
    main()
