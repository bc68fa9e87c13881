"""Films over an implicit step, so that no step is too long for a stiff one.

A film's force is that at the mean squeeze velocity of the step, the journal where it is in the
middle of it by that velocity. The force is linear in the velocity but for its direction, so what a
step sets out from matters by its direction alone: the mean of the step before. Forces of films on
each other and on contacts are solved for by their responses (Schur's complement), because a film's
tangent is not symmetric.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.components.journal_film import JournalFilm, film_of
from jaxclear.formulations.contact_rows import MiddleOfStep
from jaxclear.formulations.delassus import ContactSolution, ImplicitContact, LinearLaws
from jaxclear.formulations.laws_over_step import Averaging, Outset
from jaxclear.formulations.model import Model
from jaxclear.ground import sparse as sp
from jaxclear.ground.factorisation import eliminate
from jaxclear.ground.quantity import with_fields
from jaxclear.multibody import kinematics
from jaxclear.multibody.forces import Forces, with_rows
from jaxclear.multibody.rows import Direction, LinearRate, OnClosure, Row, combine_rates
from jaxclear.multibody.state import unpack_motion
from jaxclear.multibody.system import System
from jaxclear.multibody.tree import Wrench

# Directions of a film's force.
AXES = 2
# Forces along these axes, and a torque.
UNITS = (1, 0, 0), (0, 1, 0), (0, 0, 1)


class FilmOverStep(NamedTuple):
    """A film over a step: where its forces act, on an `arm` that is the journal's offset in the
    middle [m] as far as it is known, the `rates` along these (the squeeze velocity there), the
    journal's offset as the step begins [m], the relative `spin` [rad/s], and the mean velocity of
    the journal in the step before [m/s], 0 if there was none."""

    name: str
    film: JournalFilm
    directions: tuple[Direction, ...]
    rates: tuple[LinearRate, ...]
    first: tuple
    arm: tuple
    spin: Any
    last: tuple
    reaches: tuple

    def outset(self, unmoved: tuple, carried_on: tuple) -> Outset:
        """From the rates of the step before, or without one from those without the film."""
        before = zip(self.last, turning(self.arm, self.spin), unmoved, strict=True)
        rates = tuple(jnp.where(self.has_previous, v - t, rate) for v, t, rate in before)
        return Outset(unmoved, rates, (0.0,) * AXES)

    def linear(self, rates: tuple, forces: tuple) -> LinearLaws:
        """None: films are solved for behind what is linear (`solve_with_films`)."""
        return LinearLaws(*[[0.0] * AXES] * 3)

    def tangent(self, rates: tuple, frozen: Any) -> tuple[tuple, list]:
        """Forces at mean rates, and by how much each falls with each rate; the journal where the
        rates lead, or where `frozen` where those of the step before do."""
        half = self.reaches[0][1]

        def force(rates):
            half_spin, before = turning(self.arm, self.spin), self.last
            moved = zip(self.first, rates, half_spin, before, strict=True)
            offset = tuple(x + half * jnp.where(frozen, v, r + t) for x, r, t, v in moved)
            off_arm = zip(rates, half_spin, turning(offset, self.spin), strict=True)
            return self.film.squeeze_force(offset, tuple(r + t - now for r, t, now in off_arm))

        rates = tuple(jnp.asarray(rate, float) for rate in rates)
        one, none = jnp.ones(()), jnp.zeros(())
        value, along = jax.jvp(force, (rates,), ((one, none),))
        _, across = jax.jvp(force, (rates,), ((none, one),))
        return value, [[-along[i], -across[i]] for i in range(AXES)]

    def mean_velocity(self, rates: tuple) -> tuple:
        """Mean velocity of the journal in the bearing at mean rates [m/s]."""
        return tuple(r + t for r, t in zip(rates, turning(self.arm, self.spin), strict=True))

    @property
    def has_previous(self) -> Any:
        """Whether there was a step before."""
        return sp.total(abs(x) for x in self.last) > 0


def turning(offset: tuple, spin: Any) -> tuple:
    """Half the spin times an offset, a quarter turn on [m/s]: by which the squeeze velocity lacks
    the journal's."""
    return sp.mul(-0.5, sp.mul(spin, offset[1])), sp.mul(0.5, sp.mul(spin, offset[0]))


def films_of(system: System) -> dict[str, JournalFilm]:
    """The films of joints whose forces steps may find, by name."""
    filled = [name for name, b in system.bearings.items() if b.joint.gap_load(name) is not None]
    return {film_of(name): system.loads[film_of(name)] for name in filled}


def film_losses(system: System, forces: Forces) -> list:
    """Power that each film takes [W]."""
    by_film = {
        name: [
            sp.mul(row.force, row.direction.rate(forces.motions))
            for row in forces.rows
            if row.owner == name
        ]
        for name in films_of(system)
    }
    return [sp.neg(sp.total(powers)) for powers in by_film.values()]


def without_films(model: Model) -> Model:
    """The model whose films act by their shear alone; itself without films."""
    films = films_of(model.system)
    if not films:
        return model
    sheared = {n: with_fields(film, sheared=True) for n, film in films.items()}
    system = dataclasses.replace(model.system, loads=model.system.loads | sheared)
    return dataclasses.replace(model, system=system)


def films_over_step(
    system: System, middle: MiddleOfStep, past: list, start: Any, averaging: Averaging
) -> tuple[FilmOverStep, ...]:
    """The films over a step.

    Args:
        system: with the films.
        middle: of the step.
        past: mean velocity of each journal in the step before.
        start: of the step [s].
        averaging: its length and bias.
    """
    half = 0.5 * averaging.length
    films, result = films_of(system), []
    if not films:
        return ()
    motions = middle.free_motion.forces.motions
    motion = unpack_motion(system, [*middle.q, *middle.v])
    start_motions = kinematics.link_motions(system, *motion, start)
    for (name, film), last in zip(films.items(), past, strict=True):
        closure = system.load_closures[name]
        pose = kinematics.relative_motion(closure, motions)[1]

        def along(x, y, turn):
            wrench = Wrench((x, y, 0), (0, 0, turn))
            return Direction((OnClosure(closure, pose, wrench, film.connection),))

        units = [along(*unit).linear_rate(system, motions) for unit in UNITS]
        spin = units[-1].value
        first = kinematics.relative_motion(closure, start_motions)[1].translation[:AXES]
        arm = tuple(x + half * v for x, v in zip(first, last, strict=True))
        sizes = (1, 0, 0.5 * arm[1]), (0, 1, -0.5 * arm[0])
        rates = tuple(combine_rates(size, units) for size in sizes)
        directions = tuple(along(*size) for size in sizes)
        places = first, arm, spin, last
        result.append(
            FilmOverStep(name, film, directions, rates, *places, (averaging.reaches,) * AXES)
        )
    return tuple(result)


def solve_with_films(
    equations: ImplicitContact, reaches: list, unmoved: list, laws: LinearLaws, tangents: list
) -> ContactSolution:
    """The solution of a step with films, whose rows are the last ones.

    Args:
        equations: of the step.
        reaches: by how much forces change rates, for each row.
        unmoved: rates without forces, for each row.
        laws: of the other rows.
        tangents: of each film: its forces, how they fall with its rates, and these rates.
    """
    if not tangents:
        return equations.solve(reaches, unmoved, laws)
    size, count = len(unmoved), AXES * len(tangents)
    none, first = [0.0] * size, len(unmoved) - count
    films = range(first, size)
    base = equations.solve(reaches, unmoved, laws)
    responses = [
        equations.solve(reaches, none, LinearLaws(unit_vector(size, j), laws.dampings, none))
        for j in films
    ]
    matrix, right = [], []
    for k, (forces, falls, about) in enumerate(tangents):
        rows = range(first + AXES * k, first + AXES * (k + 1))
        for i in range(AXES):
            gain = [
                sp.total(falls[i][m] * response.rates[r] for m, r in enumerate(rows))
                for response in responses
            ]
            matrix.append([g + float(AXES * k + i == j) for j, g in enumerate(gain)])
            difference = [base.rates[r] - about[m] for m, r in enumerate(rows)]
            right.append(forces[i] - sp.dot(falls[i], difference))
    sizes = eliminate(matrix, right)
    add = lambda part: [
        sp.add(x, sp.dot(sizes, [getattr(response, part)[i] for response in responses]))
        for i, x in enumerate(getattr(base, part))
    ]
    return ContactSolution(*map(add, ContactSolution._fields))


def velocity_lag(
    system: System,
    films: tuple[FilmOverStep, ...],
    end: tuple[Any, list, list],
    means: list[tuple],
    equations: ImplicitContact,
    size: int,
) -> list:
    """Correction of the speeds at the end of a step to the mean velocities of journals in films.

    A stiff film determines the mean velocity of a step; the one at its end alternates about it.

    Args:
        system: with the films.
        films: over the step.
        end: of the step: time [s], coordinates and speeds.
        means: mean velocity of each journal [m/s].
        equations: of the step.
        size: number of its rows, those of films last.
    """
    time, q, v = end
    motions = kinematics.link_motions(system, *unpack_motion(system, [*q, *v]), time)
    rows, lags = [], []
    for film, mean in zip(films, means, strict=True):
        closure = system.load_closures[film.name]
        pose = kinematics.relative_motion(closure, motions)[1]
        for unit, now, before in zip(UNITS, mean, film.last, strict=False):
            wrench = Wrench(unit, (0, 0, 0))
            rate = Direction((OnClosure(closure, pose, wrench),)).linear_rate(system, motions)
            rows.append(rate.row)
            lags.append(now + jnp.where(film.has_previous, 0.5 * (now - before), 0.0) - rate.value)
    none, ones = [0.0] * size, [1.0] * size
    columns = [
        equations.solve(ones, none, LinearLaws(unit_vector(size, j), none, none)).accelerations
        for j in range(size - len(rows), size)
    ]
    matrix = [[kinematics.along(row, column) for column in columns] for row in rows]
    sizes = eliminate(matrix, lags)
    return [sp.dot(sizes, entries) for entries in zip(*columns, strict=True)]


def unit_vector(size: int, index: int) -> list:
    """So many numbers, 1 at the index and 0 elsewhere."""
    return [float(i == index) for i in range(size)]


def with_films(
    forces: Forces, films: tuple[FilmOverStep, ...], pushes: tuple, rates: tuple
) -> Forces:
    """The forces with the mean ones of films and the power that these dissipate.

    Args:
        forces: without films.
        films: over the step.
        pushes: mean forces of each film [N].
        rates: mean rates along them [m/s].
    """
    rows, loss = list[Row](), forces.damping_loss
    for film, push, rate in zip(films, pushes, rates, strict=True):
        rows += map(Row, (film.name,) * AXES, film.directions, push)
        loss = sp.sub(loss, sp.dot(push, rate))
    return with_rows(forces._replace(damping_loss=loss), rows) if films else forces
