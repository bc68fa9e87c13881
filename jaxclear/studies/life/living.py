"""A life on its way: rates of wear on the surfaces that the steps ask for, each from where the
motion settled before, and what was found out on the way.

Steps carry on a row of numbers: the depths of all cells, and behind them for each surface the mean
depth that its lost volume makes, whose noise is far less than that of the cells.
"""

from typing import Any

import jax
import numpy as np
from jax.flatten_util import ravel_pytree

from jaxclear.integrators.checks import Check, Checks
from jaxclear.simulation.wear import Worn
from jaxclear.studies.ledger.ledger import Ledger
from jaxclear.studies.life.cycle import (
    Cycle,
    asked_of,
    cycle,
    cycles,
    first_state,
    kind_of_cycle,
    worst_of,
)
from jaxclear.studies.life.nodes import Cells, Rate
from jaxclear.studies.life.prediction import Place, predicted, units_of_coordinates
from jaxclear.studies.life.settling import Patience, Settling, settle, settle_side_by_side
from jaxclear.studies.life.steps import CycleFailed
from jaxclear.studies.problem import Problem

# What a narrow contact makes of depths.
NARROW = (Check.WEAR_BY_CELLS,)
# So many cycles of a motion that does not settle are simulated side by side where patience lasts
# for so many times as many: then a life has enough of them to be worth a second program.
LANES, WORTH = 8, 4


class Living:
    """A life on its way: its problem, the cycles simulated so far, where the motion settled."""

    def __init__(self, problem: Problem, values: Any, patience: Patience, store: Ledger | None):
        self.problem, self.patience, self.store = problem, patience, store
        self.asked = asked_of(problem, values)
        self.motion, self.worn = first_state(problem, values)
        depth, self.unflat = flattened(self.worn)
        self.areas = _areas(problem, self.worn)
        self.cells = _cells(self.areas)
        self.count = len(depth)
        self.first_row = np.concatenate([depth, np.zeros(len(self.areas))])
        seen = problem.integrator.formulation.seen(problem.mechanism)
        self.units = units_of_coordinates(seen)
        self.places: list[Place] = []
        # Where lanes go on from, of a motion that does not settle.
        self.begins: list[Any] = []
        # False from when lanes have gone in file to the end.
        self.by_lanes = True
        self.settlings: list[Settling] = []
        self.simulated = 0
        self.last_run: Any = None
        self.kind: Any = None
        if store is not None:
            self.kind = kind_of_cycle(self.asked, self.motion, self.worn)

    def evaluate(self, row: np.ndarray, set_down: bool = False) -> Rate:
        """What a cycle wears on surfaces of these depths; not the one in which the machine is
        `set_down`. Raises `CycleFailed`."""
        depth, found = row[: self.count], None
        if self.begins:
            found = settle_side_by_side(
                self._cycles, self.begins, self.unflat(depth), self.patience, self._is_known
            )
            self.by_lanes = found is not None
        if found is None:
            begin = predicted(self.places, depth, self.units) if self.places else self.motion
            least = 2 if set_down else 1
            found = settle(self._cycle, begin, self.unflat(depth), self.patience, least=least)
        if found.last.fault:
            raise CycleFailed(found.last.fault)
        if not found.periodic:
            # States of a motion that does not settle follow no line.
            self.places.clear()
        self.places.append(Place(depth, found.last.end))
        self.settlings.append(found)
        self.begins = self._begins_after(found)
        wear = self._row(found.wear, found.lost)
        return Rate(wear, self._row(found.noise, found.noise_of_lost), len(found.cycles), found)

    def _begins_after(self, found: Settling) -> list[Any]:
        """Where lanes go on from after such cycles; none where they have settled, or would go in
        file."""
        if found.periodic or not self.by_lanes or self.patience.most < WORTH * LANES:
            return []
        ends = found.ends if found.lanes > 1 else found.cycles[-LANES:]
        settled = all(one.distance <= self.patience.within for one in ends)
        return [] if settled or len(ends) < LANES else [one.end for one in ends]

    def _is_known(self, found: Settling) -> bool:
        """Whether all that steps carry on is known as well as is asked for."""
        noise = self._row(found.noise, found.noise_of_lost)
        shares = self.cells.shares(noise, self._row(found.wear, found.lost))
        return bool(shares.max(initial=0.0) <= self.patience.noise)

    def _row(self, depths: Worn, volumes: Worn) -> np.ndarray:
        """Depths of all cells, and behind them those of each surface as its volume has it."""
        means = flattened(volumes)[0] / np.array([own.sum() for own in self.areas])
        return np.concatenate([flattened(depths)[0], means])

    def checks(self) -> Checks:
        """The worst of every figure over all cycles that were taken as the motion. How wide scars
        are beside cells is that of the last ones: in a new wall every contact is narrow, and what
        was worn there too shallow is worn on."""
        worst = worst_of([one.checks for s in self.settlings for one in s.taken])
        last = worst_of([one.checks for one in self.settlings[-1].taken])
        by_cells = {check: last.figures[check] for check in NARROW if check in last.figures}
        return Checks.of(worst.figures | by_cells)

    def _cycle(self, motion: Any, worn: Worn) -> Cycle:
        """A cycle, from the store where it is there."""
        known = self._taken(motion, worn)
        if known is None:
            known, self.last_run = cycle(self.asked, motion, worn)
            self._keep(motion, worn, known)
        self.simulated += 1
        return known

    def _cycles(self, motions: Any, worn: Worn) -> list[Cycle]:
        """A cycle of each lane, from the store where all are there."""
        self.simulated += len(motions)
        known = [self._taken(motion, worn) for motion in motions]
        if all(one is not None for one in known):
            return known
        found = cycles(self.asked, motions, worn)
        for motion, before, one in zip(motions, known, found, strict=True):
            if before is None:
                self._keep(motion, worn, one)
        return found

    def _taken(self, motion: Any, worn: Worn) -> Any:
        """A cycle from the store; None where it is not there."""
        if self.store is None:
            return None
        return self.store.taken(flattened((motion, worn))[0], self.kind)

    def _keep(self, motion: Any, worn: Worn, one: Cycle) -> None:
        if self.store is not None:
            self.store.add(flattened((motion, worn))[0], one)


def flattened(tree: Any) -> tuple[np.ndarray, Any]:
    """All numbers in a row, and the way back."""
    flat, back = ravel_pytree(tree)
    return np.asarray(flat), back


def _areas(problem: Problem, worn: Worn) -> list[np.ndarray]:
    """Areas [m2] of the cells of each worn surface."""
    connections = problem.mechanism.connections
    areas = {
        joint: {s: np.asarray(connections[joint].joint.maps()[s][0].areas()) for s in surfaces}
        for joint, surfaces in worn.items()
    }
    return [own.ravel() for own in jax.tree.leaves(areas)]


def _cells(areas: list[np.ndarray]) -> Cells:
    """How depths stand in a row: cells of one surface after the other, then their mean depths."""
    sizes = [*(own.size for own in areas), *(1 for _ in areas)]
    ends = np.cumsum(sizes)
    parts = tuple(slice(int(end - own), int(end)) for own, end in zip(sizes, ends, strict=True))
    return Cells(parts, np.concatenate([*areas, np.ones(len(areas))]))
