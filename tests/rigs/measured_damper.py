"""The measured friction damper with backlash: its records, its quasi-static force as a function of
what is not known, and the same machine as a mechanism.

A frame that is moved drives a drum through a play of +- gap and a spring, which gives by `give` at
the force at which the drum slides."""

from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc

FILE = Path(__file__).parents[1] / "refdata" / "brfd_backlash_damper.csv"
# Frequency [Hz] and nominal amplitude [mm]; the first is fitted, the others are predicted.
RECORDS = ((0.25, 12.7), (0.5, 25.4), (1.0, 25.4), (0.25, 38.1), (1.0, 12.7))
UNITS = {"force": "kN", "lost motion": "mm", "stiffness": "kN/mm", "energy": "J"}


class DamperRecord(NamedTuple):
    """One steady cycle: time [s], displacement [mm], force [kN]."""

    time: np.ndarray
    displacement: np.ndarray
    force: np.ndarray

    @property
    def energy(self) -> float:
        """Dissipated in the cycle [J]."""
        return energy(self.displacement, self.force)


def energy(displacement, force) -> float:
    """Inside the loop of force over displacement [J]."""
    return abs(float(np.trapezoid(force, displacement)))


def records() -> dict[tuple[float, float], DamperRecord]:
    """All five."""
    rows = np.loadtxt(FILE, delimiter=",", skiprows=6)
    own = lambda key: rows[(rows[:, 0] == key[0]) & (rows[:, 1] == key[1]), 2:].T
    return {key: DamperRecord(*own(key)) for key in RECORDS}


def marched(displacement, plateau, gap, give, exponent=1.0):
    """Force [kN] (n,) over a cycle of displacements [mm], which was gone through once before."""
    cycle = jnp.asarray(displacement)

    def step(drum, at):
        apart = at - drum
        bent = jnp.clip(jnp.abs(apart) - gap, 0.0)
        slid = jnp.clip(bent - give, 0.0) * jnp.sign(apart)
        share = jnp.minimum(bent, give) / give
        touches = share > 0
        force = jnp.where(touches, jnp.where(touches, share, 1.0) ** exponent, 0.0)
        return drum + slid, jnp.sign(apart) * plateau * force

    twice = jnp.concatenate([cycle, cycle])
    return jax.lax.scan(step, cycle[0] - gap - give, twice)[1][len(cycle) :]


def damper(record: DamperRecord, stiffening: bool = False) -> jc.Problem:
    """The force in a record as a function of what is not known: the plateau [kN], half the play
    [mm], what the spring gives at the plateau [mm], and the exponent of its force."""
    uniform = lambda low, high, unit: jc.Dimension(
        0.5 * (low + high), jc.distribution.Uniform(0.5 * (high - low)), unit=unit
    )
    unknowns = {
        "plateau": uniform(5.0, 15.0, "kN"),
        "gap": uniform(0.0, 4.0, "mm"),
        "give": uniform(0.1, 5.0, "mm"),
    }

    def answers(plateau, gap, give, exponent=1.0):
        force = marched(record.displacement, plateau, gap, give, exponent)
        mean = 0.5 * (force[1:] + force[:-1])
        return {
            "force": force,
            "lost motion": gap + give,
            "stiffness": plateau / give,
            "energy": jnp.abs(jnp.sum(mean * jnp.diff(record.displacement))),
        }

    if stiffening:
        unknowns |= {"exponent": uniform(1.0, 4.0, "1")}
        return jc.FunctionProblem(answers, unknowns, units=UNITS)
    linear = lambda plateau, gap, give: answers(plateau, gap, give)
    return jc.FunctionProblem(linear, unknowns, units=UNITS)


def mechanism(record: DamperRecord, plateau: float, gap: float, give: float) -> jc.Mechanism:
    """The same as bodies on slides; lengths in mm and forces in kN as above."""
    table = jc.TimeTable(record.time, 1e-3 * record.displacement, beyond="straight")
    place = lambda body: jc.Marker(body, (0.0, 0.0, 0.0), axis="x")
    slide = jc.joint.Prismatic
    driven = slide(drive=jc.drive.Position(table))
    body = lambda mass: jc.Body(mass, (1.0, 1.0, 1.0))
    start = 1e-3 * (record.displacement[0] - gap - give)
    return jc.Mechanism(
        {"frame": body(1.0), "drum": body(5.0)},
        {
            "moved": jc.Connection(driven, place("ground"), place("frame")),
            "band": jc.Connection(slide(), place("ground"), place("drum")),
            "play": jc.Connection(slide(), place("frame"), place("drum")),
        },
        {
            "spring": jc.load.JointStop(
                "play", -1e-3 * gap, 1e-3 * gap, stiffness=1e6 * plateau / give
            ),
            # Sticks to within a hundredth of the speeds of the records.
            "friction": jc.load.JointFriction("band", 1e3 * plateau, 2e-4),
        },
        start={"band": float(start)},
    )
