"""Rates of wear on the surfaces that the steps of a life ask for, each from where the motion
settled before, and what surfaces become by what contacts lose.

Where a motion settles on a surface worn further is carried on in a straight line from the last two
surfaces on which it settled: a journal follows the wall as that wears. Begun where the wall was, it
would fall, and a cycle would go to its settling.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from jaxclear.integrators.checks import Check, Checks
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.system import prepare, wearing_in
from jaxclear.results.state_history import SavedMotion
from jaxclear.simulation.wear import Worn
from jaxclear.studies.life.cycle import (
    Cycle,
    cycle,
    cycle_request,
    first_state,
    kind_of_cycle,
    worst_of,
)
from jaxclear.studies.life.losses import Merged, merge, side_by_side, wear_in_parts
from jaxclear.studies.life.settling import Patience, Settling, settle
from jaxclear.studies.life.steps import PARTS, Cells, CycleFailed, Job, Rate
from jaxclear.studies.problem import Problem
from jaxclear.studies.store.batch import as_arrays, as_tree
from jaxclear.studies.store.digest import in_texts
from jaxclear.studies.store.store import CURRENT, compute_address

# What a narrow contact makes of depths.
NARROW = (Check.WEAR_BY_CELLS,)
# So many times the way between two surfaces a line is carried on at the most.
FURTHEST = 4.0
# Numbers in a vector register of the widest.
LANES = 8
# Losses whose contacts lie within such a part of a cell are one where a step has the fewest parts.
ALIKE = 0.25


class Rates:
    """Of a machine: its problem, the cycles simulated so far, where the motion settled."""

    def __init__(self, problem: Problem, values: Any, patience: Patience):
        self.problem, self.patience, self.store = problem, patience, CURRENT.get()
        self.request = cycle_request(problem, values)
        self.motion, self.worn = first_state(problem, values)
        depth, self.unflat = flattened(self.worn)
        self.cells = _make_cells(problem, self.worn)
        self.count = len(depth)
        self.first_row = np.concatenate([depth, np.zeros(len(self.cells.surfaces))])
        modelled = problem.integrator.formulation.modelled(problem.mechanism)
        self.units = units_of_coordinates(modelled)
        self.places: list[Place] = []
        self.settlings: list[Settling] = []
        self.simulated = 0
        self.last_run: Any = None
        self.kind = functools.cache(lambda: kind_of_cycle(self.request, self.motion, self.worn))
        if self.store is not None:
            self.question = compute_address(in_texts(problem), np.asarray(values))

    def evaluate(self, row: np.ndarray, set_down: bool = False) -> Rate:
        """What a cycle wears on surfaces of these depths; not the one in which the machine is
        `set_down`. Raises `CycleFailed`."""
        depth = row[: self.count]
        self._refuse_worn_through(depth)
        begin = predicted(self.places, depth, self.units) if self.places else self.motion
        least = 2 if set_down else 1
        result = settle(self._simulate_cycle, begin, self.unflat(depth), self.patience, least=least)
        if result.last.fault:
            raise CycleFailed(result.last.fault)
        if not result.periodic:
            # States of a motion that does not settle follow no line.
            self.places.clear()
        self.places.append(Place(depth, result.last.end))
        self.settlings.append(result)
        wear = self._row(result.wear, result.volumes)
        return Rate(wear, self._row(result.noise, result.volume_noise), len(result.cycles), result)

    def _refuse_worn_through(self, depth: np.ndarray) -> None:
        """Raises `CycleFailed` where nothing is left of a surface of this depth."""
        wearing = wearing_in(self.problem.mechanism)
        for joint, surfaces in self.unflat(depth).items():
            for surface, worn_depth in surfaces.items():
                thickness = float(wearing[joint].maps()[surface][0].thickness)
                if float(worn_depth.max()) >= thickness:
                    raise CycleFailed(
                        f'Worn through: the {surface} of "{joint}" is '
                        f"{float(worn_depth.max()):.4g} m deep, of a radius of {thickness:.4g} m."
                    )

    def carry(self, jobs: Sequence[Job]) -> list[np.ndarray]:
        """Of each job what is left of its depths by its losses (`wear_in_parts`). Several are worn
        in the lanes of one kernel, which take little longer than two of them alone."""
        if len(jobs) == 2:
            return [row for job in jobs for row in self.carry([job])]
        # One program for many numbers of jobs.
        spare = -len(jobs) % LANES if len(jobs) > 1 else 0
        padded = [*jobs, *[jobs[0]._replace(parts=0)] * spare]
        merged: dict[tuple[int, int], Merged] = {}
        for job in jobs:
            if _losses_of(job) not in merged:
                merged[_losses_of(job)] = _merge_losses(job)
        shares = [(job.share, merged[_losses_of(job)]) for job in jobs]
        losses, counts = side_by_side([*shares, *shares[:1] * spare])
        parts = np.array([job.parts for job in padded])
        worn = _stack([self.unflat(job.row[: self.count]) for job in padded])
        worn = wear_in_parts(self.request, worn, losses, counts, parts)
        maps = [np.reshape(depths, (len(padded), -1)) for depths in jax.tree.leaves(worn)]
        means = self.cells.means
        lost = [sum(n * means(rate.wear) for n, rate in job.losses) for job in jobs]
        return [
            np.concatenate([row, means(job.row) + job.share * some])
            for row, job, some in zip(np.concatenate(maps, axis=1), jobs, lost, strict=False)
        ]

    def halves(self, rate: Rate) -> tuple[Rate, Rate] | None:
        """Of a mean over cycles two rates, by the former and the latter half of these, by
        which each surface loses as much; None of a periodic cycle."""
        taken = rate.settled.taken
        if rate.settled.periodic or len(taken) < 2:
            return None
        middle, losses = len(taken) // 2, rate.settled.volumes
        former, latter = _as_much(taken[:middle], losses), _as_much(taken[middle:], losses)
        return rate._replace(settled=former), rate._replace(settled=latter)

    def _row(self, depths: Worn, volumes: Worn) -> np.ndarray:
        """Depths of all cells, and behind them those of each surface as its volume has it."""
        return np.concatenate([flattened(depths)[0], flattened(volumes)[0] / self.cells.full_areas])

    def checks(self) -> Checks:
        """The worst of every figure over all cycles that were taken as the motion. How wide scars
        are beside cells is that of the last ones: in a new wall every contact is narrow, and what
        was worn there too shallow is worn on."""
        worst = worst_of([one.checks for s in self.settlings for one in s.taken])
        last = worst_of([one.checks for one in self.settlings[-1].taken])
        by_cells = {check: last.figures[check] for check in NARROW if check in last.figures}
        return Checks.of(worst.figures | by_cells)

    def _simulate_cycle(self, motion: Any, worn: Worn) -> Cycle:
        """A cycle, from the store where it is there."""
        self.simulated += 1
        store = self.store

        def compute() -> Cycle:
            result, self.last_run = cycle(self.request, motion, worn)
            if store is not None:
                store.write(address, as_arrays(result))
            return result

        if store is None:
            return compute()
        address = compute_address(self.question, flattened((motion, worn))[0])
        return store.obtain(address, lambda: as_tree(self.kind, store.load(address)), compute, True)


def _losses_of(job: Job) -> tuple[int, int]:
    """What jobs have in common whose losses are the same but for their share."""
    return id(job.losses), job.parts


def _merge_losses(job: Job) -> Merged:
    """The losses of a job, but for its share."""
    cycles = [
        (length / len(rate.settled.taken), one.losses, one.footprints)
        for length, rate in job.losses
        for one in rate.settled.taken
    ]
    return merge(cycles, ALIKE * PARTS / job.parts)


def _stack(trees: Sequence[Any]) -> Any:
    """Trees of arrays with an axis in front."""
    return jax.tree.map(lambda *each: np.stack(each), *trees)


def flattened(tree: Any) -> tuple[np.ndarray, Any]:
    """All numbers in a row, and the way back."""
    flat, back = ravel_pytree(tree)
    return np.asarray(flat), back


class Half(NamedTuple):
    """Some of the cycles that are taken as the motion."""

    taken: tuple[Cycle, ...]


def _as_much(half: Sequence[Cycle], losses_now: Worn) -> Half:
    """These cycles with as much lost by each surface as a mean over them all."""
    scaled = []
    for one in half:
        losses = dict(one.losses)
        for (joint, surface), (volumes, places) in one.losses.items():
            mean = np.mean([float(each.volumes[joint][surface]) for each in half])
            share = losses_now[joint][surface] / mean if mean > 0 else 1.0
            losses[joint, surface] = share * volumes, places
        scaled.append(dataclasses.replace(one, losses=losses))
    return Half(tuple(scaled))


def _make_cells(problem: Problem, worn: Worn) -> Cells:
    """How depths of these surfaces stand in a row."""
    wearing = wearing_in(problem.mechanism)
    areas = {
        joint: {s: np.asarray(wearing[joint].maps()[s][0].areas()) for s in surfaces}
        for joint, surfaces in worn.items()
    }
    rows = [a.ravel() for a in jax.tree.leaves(areas)]
    ends = np.cumsum([a.size for a in rows])
    parts = tuple(slice(int(end - a.size), int(end)) for a, end in zip(rows, ends, strict=True))
    return Cells(parts, np.concatenate(rows))


class Place(NamedTuple):
    """A motion settled on surfaces of these depths [m], all cells in a row."""

    depth: np.ndarray
    motion: SavedMotion


def units_of_coordinates(mechanism: Mechanism) -> tuple[str, ...]:
    """Unit of each coordinate of the tree."""
    return tuple(
        unit
        for link, branch in zip(prepare(mechanism).links, mechanism.topology.branches, strict=True)
        for unit in link.joint.units[: branch.coordinate_count]
    )


def predicted(places: Sequence[Place], depth: np.ndarray, units: tuple[str, ...]) -> SavedMotion:
    """The motion at which a cycle on given surfaces begins, extrapolated from the last two.

    Args:
        places: surfaces on which the motion has settled, with its end there.
        depth: of all cells [m].
        units: of the coordinates, which say what is an angle or a quaternion.
    """
    last = places[-1].motion
    before = next((p for p in places[-2::-1] if np.any(p.depth != places[-1].depth)), None)
    if before is None:
        return last
    change = places[-1].depth - before.depth
    share = float(np.dot(depth - places[-1].depth, change) / np.dot(change, change))
    share = float(np.clip(share, -FURTHEST, FURTHEST))
    coordinates = np.asarray(last.coordinates - before.motion.coordinates)
    turns = np.array([unit == "rad" for unit in units])
    # Whole turns are no change of place.
    coordinates = coordinates - np.where(turns, 2 * np.pi * np.round(coordinates / 2 / np.pi), 0.0)
    # So is a quaternion's opposite.
    quaternion = np.array([unit == "1" for unit in units])
    if np.any(np.abs(coordinates[quaternion]) > 0.5):
        return last
    speeds = last.speeds - before.motion.speeds
    return SavedMotion(
        last.time,
        jnp.asarray(last.coordinates + share * coordinates),
        jnp.asarray(last.speeds + share * speeds),
        last.remembered,
        last.names,
        last.remembered_names,
        last.redundancy,
    )
