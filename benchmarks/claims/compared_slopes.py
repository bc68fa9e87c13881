"""Slopes through impacts of rigid contact: how many are told and how many of these are wrong, by
step, with the comparison with other steps and without it.

A slope is that of one coordinate or speed at the end of a run by one number of its mechanism: a
journal, a pendulum of two links, a link in two bearings, slider-cranks with one bearing and two;
with friction and without, elastic and plastic impacts. References are slopes in steps of 0.1 us
where those in steps of 0.2 us say the same; other slopes are not counted. A right one is off by a
fiftieth of itself at the most. Takes a quarter of an hour.
"""

import functools
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple
from unittest.mock import patch

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import run_tables
from jaxclear.integrators import derivative_error, moreau_jean
from jaxclear.simulation import derivatives

STEPS, REFERENCES = (1e-6, 5e-6, 2e-5, 1e-4), (1e-7, 2e-7)
RIGHT = 0.02
# Slopes are known where references differ by no more than this share, of one much smaller than the
# largest of its kind (coordinates or speeds) by the same number, of so small a share of that one.
ALIKE, SMALL = 3e-3, 0.02
# Slopes smaller than this share of the largest are rounding.
ROUNDING = 1e-9
# By what is refused: the share of a slope by which other steps may tell it to be off, and the
# share of the gap to which errors of places may have grown.
RULES = {
    "with other steps": (derivatives.TRUSTED, derivative_error.TRUSTED_IMPACTS),
    "growth alone": (math.inf, derivative_error.TRUSTED_IMPACTS),
    "growth alone, a fifth of it": (math.inf, derivative_error.TRUSTED_IMPACTS / 5),
}


class Rig(NamedTuple):
    """A mechanism, its varied numbers, the start of its runs and their ends [s]."""

    mechanism: jc.Mechanism
    variables: dict[str, Callable]
    state: jc.State
    ends: tuple[float, ...]


def bearing(restitution: float, mu: float, clearance: float) -> jc.clearance.PlanarJournalBearing:
    return jc.clearance.PlanarJournalBearing(
        jc.contact.Rigid(restitution=restitution),
        jc.friction.Coulomb(mu_kinetic=mu) if mu else None,
        clearance=clearance,
        bearing_radius=1e-2,
    )


def clearance(name: str) -> Callable:
    return lambda rig: rig.connections[name].joint.clearance


def restitution(name: str) -> Callable:
    return lambda rig: rig.connections[name].joint.contact.restitution


def speed(name: str, place: int) -> Callable:
    return lambda rig: rig.speeds[name][place]


def journal(joint: Any, start: Any, speeds: Any, gravity: float, ends: tuple) -> Rig:
    mechanism = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(joint, "ground", "journal")},
        {"gravity": jc.load.Gravity((0.0, -gravity))},
        start={"journal": (*start, 0.0)},
        speeds={"journal": speeds},
    )
    varied = {
        "clearance": clearance("B"),
        "restitution": restitution("B"),
        "start": lambda rig: rig.start["journal"][0],
        "speed along x": speed("journal", 0),
        "speed along y": speed("journal", 1),
    }
    return Rig(mechanism, varied, jc.State(concentric=False), ends)


def slider_crank(restituted: float, mu: float) -> Rig:
    joint = bearing(restituted, mu, 2e-4)
    mechanism = jc.scenes.slider_crank(
        clearance=2e-4, friction=joint.friction, contact=joint.contact, crank_speed=50.0
    )
    varied = {
        "clearance": clearance("B"),
        "restitution": restitution("B"),
        "mass": lambda rig: rig.bodies["slider"].mass,
        "gravity": lambda rig: rig.loads["gravity"].acceleration[1],
    }
    return Rig(mechanism, varied, jc.State(), (0.002, 0.004, 0.007, 0.013, 0.02, 0.03))


def slider_crank_of_two(restituted: float, mu: float) -> Rig:
    joint = bearing(restituted, mu, 2e-4)
    bodies = {
        "crank": jc.Body(0.3, 1e-4, (0.025, 0.0)),
        "rod": jc.Body(0.21, 2.5e-4, (0.06, 0.0)),
        "slider": jc.Body(0.14, 1e-4),
    }
    driven = jc.joint.Revolute(drive=jc.drive.ConstantSpeed(50.0))
    connections = {
        "O": jc.Connection(driven, "ground", "crank"),
        "A": jc.Connection(joint, "crank", "rod", at=(0.05, 0.0)),
        "B": jc.Connection(joint, "rod", "slider", at=(0.12, 0.0)),
        "G": jc.Connection(
            jc.joint.Prismatic(), jc.Marker("ground", axis="x"), jc.Marker("slider", axis="x")
        ),
    }
    weight = {"gravity": jc.load.Gravity((0.0, -9.81))}
    mechanism = jc.Mechanism(bodies, connections, weight, guess={"G": 0.17})
    varied = {
        "clearance A": clearance("A"),
        "clearance B": clearance("B"),
        "restitution": restitution("B"),
        "mass": lambda rig: rig.bodies["slider"].mass,
    }
    return Rig(mechanism, varied, jc.State(), (0.002, 0.004, 0.007, 0.013, 0.02, 0.03))


def pendulum_of_two(restituted: float, mu: float) -> Rig:
    joint = bearing(restituted, mu, 4e-4)
    mechanism = jc.Mechanism(
        {
            "upper": jc.Body(1.0, 2e-3, com=(0.0, -0.1)),
            "lower": jc.Body(0.5, 1e-3, com=(0.0, -0.1)),
        },
        {
            "B": jc.Connection(joint, "ground", jc.Marker("upper")),
            "C": jc.Connection(joint, jc.Marker("upper", at=(0.0, -0.2)), jc.Marker("lower")),
        },
        {"gravity": jc.load.Gravity((0.0, -9.81))},
        start={
            "upper": (0.0, 0.0, 0.05),
            "lower": (0.2 * np.sin(0.05), -0.2 * np.cos(0.05), -0.03),
        },
        speeds={"upper": (0.0, -0.02, 0.2), "lower": (0.01, 0.05, -0.1)},
    )
    varied = {
        "clearance B": clearance("B"),
        "clearance C": clearance("C"),
        "restitution": restitution("B"),
        "speed": speed("upper", 1),
        "mass": lambda rig: rig.bodies["lower"].mass,
    }
    return Rig(mechanism, varied, jc.State(concentric=False), (0.008, 0.015, 0.025, 0.04, 0.06))


def link_in_two(restituted: float, mu: float) -> Rig:
    joint = bearing(restituted, mu, 4e-4)
    at = lambda x: (jc.Marker("ground", at=(x, 0.0)), jc.Marker("link", at=(x, 0.0)))
    mechanism = jc.Mechanism(
        {"link": jc.Body(1.0, 2e-3)},
        {"B": jc.Connection(joint, *at(-0.1)), "C": jc.Connection(joint, *at(0.1))},
        {"gravity": jc.load.Gravity((0.0, -9.81))},
        start={"link": (1e-5, 0.0, 3e-4)},
        speeds={"link": (0.01, 0.02, 0.1)},
    )
    varied = {
        "clearance B": clearance("B"),
        "clearance C": clearance("C"),
        "restitution": restitution("B"),
        "speed": speed("link", 1),
    }
    return Rig(mechanism, varied, jc.State(concentric=False), (0.01, 0.02, 0.03, 0.045, 0.06))


def rigs() -> Iterator[Rig]:
    """All of them; starts and speeds of journals are drawn, always the same."""
    drawn = np.random.default_rng(5)
    spins = 0.0, 0.0, 0.0, 0.0, 30.0, 0.5, 3.0, -20.0
    laws = (0.8, 0.0), (1.0, 0.0), (0.5, 0.0), (0.9, 0.0), (0.8, 0.2), (1.0, 0.2), (0.5, 0.1)
    for law, spin in zip((*laws, (0.9, 0.1)), spins, strict=True):
        start, speeds = drawn.uniform(-4e-4, 4e-4, 2), drawn.uniform(-0.2, 0.2, 2)
        ends = 0.02, 0.04, 0.06, 0.08, 0.11
        yield journal(bearing(*law, 1e-3), start, (*speeds, spin), 0.0, ends)
    for law in ((0.8, 0.0), (0.5, 0.2), (0.9, 0.1), (0.0, 0.0)):
        start, speeds = drawn.uniform(-4e-4, 4e-4, 2), drawn.uniform(-0.1, 0.1, 2)
        ends = 0.02, 0.035, 0.05, 0.07, 0.11
        yield journal(bearing(*law, 1e-3), start, (*speeds, 1.0), 9.81, ends)
    ends = 0.025, 0.033, 0.039, 0.045, 0.051, 0.057, 0.062, 0.07, 0.075, 0.08, 0.09
    yield journal(bearing(0.8, 0.0, 1e-3), (0.0, 0.0), (0.0, -0.05, 0.0), 9.81, ends)
    for build in (slider_crank, slider_crank_of_two):
        yield from (build(*law) for law in ((0.9, 0.0), (0.5, 0.1), (0.0, 0.1)))
    for build in (pendulum_of_two, link_in_two):
        yield from (build(*law) for law in ((0.8, 0.0), (0.5, 0.1), (0.0, 0.3)))


@contextmanager
def refused_by(compared: float, grown: float) -> Iterator[None]:
    """Programs that are traced in here refuse slopes by these shares."""
    with (
        patch.multiple(derivatives, TRUSTED=compared),
        patch.multiple(derivative_error, TRUSTED_IMPACTS=grown),
    ):
        yield


@contextmanager
def nothing_refused() -> Iterator[None]:
    """Programs that are traced in here tell all slopes, known or not."""
    with (
        patch.multiple(derivatives, TRUSTED=math.inf),
        patch.multiple(
            moreau_jean,
            trusted_impacts=lambda found, _: found,
            known_at_end=lambda *given: given[-1],
        ),
    ):
        yield


def slopes(rig: Rig, rule: Any, steps: tuple[float, ...]) -> np.ndarray:
    """[step, end, coordinate or speed, variable], nan where this rule refuses them, a context
    of `refused_by` or `nothing_refused`."""
    topology = rig.mechanism.topology
    count = topology.coordinate_count + topology.speed_count
    asked = jc.Problem(
        rig.mechanism,
        {f"{i}": functools.partial(_number, place=i) for i in range(count)},
        {name: jc.Variable(place, tolerance=1e-9) for name, place in rig.variables.items()},
        duration=rig.ends[0],
        integrator=jc.integrator.MoreauJean(steps[0]),
        save=2,
        state=rig.state,
    )

    @jax.jit
    def found(end, step):
        own = eqx.tree_at(lambda p: (p.duration, p.integrator.step), asked, (end, step))
        answer = lambda values: jnp.stack(list(own.evaluate(values).responses.values()))
        return jax.jacfwd(answer)(own.nominal())

    with rule:
        return np.stack([[np.asarray(found(end, step)) for end in rig.ends] for step in steps])


def _number(run: jc.Trajectory, place: int) -> Any:
    return run.states[-1][place]


def known(references: np.ndarray) -> np.ndarray:
    """Which slopes both references tell, [end, coordinate or speed, variable]."""
    fine, other = references
    size = abs(fine)
    kinds = np.split(size, 2, axis=1)
    largest = [np.broadcast_to(np.max(kind, axis=1, keepdims=True), kind.shape) for kind in kinds]
    scale = np.maximum(size, SMALL * np.concatenate(largest, axis=1))
    counts = size > ROUNDING * np.max(size, axis=(1, 2), keepdims=True)
    return counts & (abs(fine - other) < ALIKE * scale)


def rows_of(options: Any) -> list[dict[str, Any]]:
    """A row for each rule and step."""
    chosen = list(rigs())[::6] if options.quick else list(rigs())
    errors: dict[tuple[str, float], list[np.ndarray]] = {}
    for number, rig in enumerate(chosen, 1):
        references = slopes(rig, nothing_refused(), REFERENCES)
        counted, wanted = known(references), references[0]
        for name, rule in RULES.items():
            for step, own in zip(STEPS, slopes(rig, refused_by(*rule), STEPS), strict=True):
                off = abs(own - wanted)[counted] / abs(wanted)[counted]
                errors.setdefault((name, step), []).append(off)
        jax.clear_caches()
        print(f"{number} of {len(chosen)}", flush=True)
    return [_row(name, step, np.concatenate(off)) for (name, step), off in errors.items()]


def _row(name: str, step: float, off: np.ndarray) -> dict[str, Any]:
    """Of all known slopes, by how much of themselves they are off; nan: refused."""
    told = off[~np.isnan(off)]
    return {
        "refused by": name,
        "step [us]": 1e6 * step,
        "known": len(off),
        "told": len(told),
        "wrong": int(np.sum(told > RIGHT)),
        "largest error": float(np.max(told, initial=0.0)),
    }


if __name__ == "__main__":
    run_tables({"slopes of rigid steps": rows_of})
