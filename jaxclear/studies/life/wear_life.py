"""The wear of a machine over its life: `jaxclear.wear_life`, and of many copies whose numbers vary,
one life after the other: `jaxclear.wear_life_sample`.

A cycle is simulated, what its contacts lose put on the surfaces as many times as an error control
allows, and so on, each cycle from where the one before settled. One program is compiled for all:
worn surfaces and numbers are inputs of it.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_flags, check_number
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.system import wearing_in
from jaxclear.simulation import progress
from jaxclear.simulation.simulate import SimulationError
from jaxclear.simulation.wear import with_coarser_cells
from jaxclear.studies.answer import AbstractAnswer, Column, Stated, with_unit
from jaxclear.studies.life.cycle import as_problem, check_cycle, check_cycles, check_period
from jaxclear.studies.life.rates import Rates
from jaxclear.studies.life.result import DEPTH, HOUR, VOLUME, Stage, WearLife
from jaxclear.studies.life.settling import Patience
from jaxclear.studies.life.steps import (
    CycleFailed,
    Length,
    Machine,
    Node,
    Rate,
    live,
    live_along,
    live_by_jumps,
)
from jaxclear.studies.problem import Problem
from jaxclear.studies.sampling import draw
from jaxclear.studies.store.store import open_store

# Ends of a cycle this far apart are the same, as in `steady_cycle`.
SETTLED = 1e-3
# The first step wears at most this share of the smallest clearance, in at most this share of the
# life.
FIRST_DEPTH, FIRST_SHARE = 0.1, 0.25


@answering
def wear_life(
    subject: Mechanism | Problem,
    period: float | None = None,
    *,
    cycles: float | None = None,
    hours: float | None = None,
    accuracy: float = 1e-2,
    jump: float | None = None,
    max_cycles: int = 12,
    store: str | Path | None = None,
    verify: bool = False,
    progress_bar: bool = False,
) -> WearLife:
    """Wear over many cycles, from few simulated ones.

    Cycle jumps are chosen so that the relative error of the wear in each jump, and so of the whole
    life, is about `accuracy` (root mean square over the cells of a surface). A rate is that of a
    periodic cycle (`steady_cycle`) or, where there is none, a mean over cycles, whose scatter
    belongs to the error. A surface that wears no more is not simulated further; a life ends where a
    surface is worn through or a cycle fails.

    Args:
        subject: a `Mechanism`, or a `Problem` whose duration is the period, at its nominal values,
            and whose responses are followed.
        period: period of a mechanism [s], > 0; None for a problem.
        cycles: number of cycles, at most 2^53; by default 1e6 of a problem, of a mechanism it or
            `hours` must be given.
        hours: hours of operation [h], > 0, in the place of `cycles`; None by default.
        accuracy: relative error of a jump [1], > 0; 0.01 by default.
        jump: fixed length of the jumps [cycles], each with the wear rate at its start; None
            (default) for chosen ones.
        max_cycles: largest number of cycles over which a rate is averaged; 12 by default.
        store: folder that keeps every cycle, from which a life is continued; None (default) for
            none.
        verify: whether a second life, on cells twice as wide, gives the error that cells leave in
            the depth; False by default.
        progress_bar: whether to show the progress; False by default.

    Returns:
        The `WearLife`.

    Raises:
        ValueError: if an argument is wrong.
        SimulationError: if the first cycle fails.
    """
    if isinstance(subject, Mechanism) and period is not None and cycles is None and hours is None:
        check_number("period of wear_life", period, "s", above=0)
        raise ValueError(
            f"wear_life is given a period of {float(period):g} s and no number of cycles: give it "
            "by name, cycles=..., or hours=... of operation."
        )
    if hours is not None:
        check_number("hours of wear_life", hours, "h", above=0)
        if cycles is not None:
            raise ValueError("wear_life is given cycles and hours; leave one of them out.")
    check_number("accuracy of wear_life", accuracy, above=0)
    if jump is not None:
        check_number("jump of wear_life", jump, at_least=1)
    check_count("max_cycles of wear_life", max_cycles)
    check_flags("wear_life", progress_bar=progress_bar, verify=verify)
    length = 1e6 if cycles is None else cycles
    check_cycles("wear_life", length)
    problem = as_problem("wear_life", subject, period, max_cycles)
    if hours is not None:
        length = max(HOUR * hours / float(problem.duration), 1.0)
        check_cycles("wear_life", length)
    check_wear_problem(problem)
    with open_store(store, "a wear life", problem), progress.bar(progress_bar, "wear life"):
        rates = Rates(problem, problem.nominal(), Patience(SETTLED, accuracy, max_cycles))
        life = lived(rates, float(length), float(accuracy), jump)
    if not verify:
        return life
    # Outside the folder, which knows cycles by their surfaces alone.
    return dataclasses.replace(life, by_cells=_error_of_cells(life, rates.patience))


def _error_of_cells(life: WearLife, patience: Patience) -> float:
    """The relative error that cells leave in the depth of a life, from another one with the same
    steps on cells twice as wide."""
    coarser = with_coarser_cells(life.problem.mechanism, 2.0)
    problem = eqx.tree_at(lambda tree: tree.mechanism, life.problem, coarser)
    rates = Rates(problem, problem.nominal(), patience)
    other = lived(rates, float(life.cycles[-1]), life.accuracy, None, life.lengths)
    depth, reached = life.at_end(DEPTH), min(life.cycles[-1], other.cycles[-1])
    coarse, fine = (float(one.over_life(DEPTH, reached)) for one in (other, life))
    # Scars that have grown to the shape of the part have edges: errors are of order 1 in the cells.
    return abs(coarse - fine) / depth if depth else 0.0


def lived(
    rates: Rates, cycles: float, accuracy: float, jump: float | None, lengths: Sequence[Length] = ()
) -> WearLife:
    """The life of a machine.

    Args:
        rates: of wear, on surfaces that the steps ask for.
        cycles: of the life.
        accuracy: of each step [1].
        jump: length of equal steps [cycles]; None: error control.
        lengths: steps of another life, to be taken instead.
    """
    row, cells, problem = rates.first_row, rates.cells, rates.problem
    mechanism, period = problem.mechanism, float(problem.duration)
    check_period("wear_life", mechanism, float(rates.motion.time), period, rates.patience.most)
    try:
        rate = rates.evaluate(row, set_down=problem.state.motion is None)
    except CycleFailed as reason:
        raise SimulationError(f"The life has no first cycle: {reason}", rates.last_run) from None
    ended = float(rate.settled.last.end.time)
    check_period("wear_life", mechanism, ended - period, period)
    start = Node.first(row, rate, cells)
    machine = Machine(rates.evaluate, rates.carry, cells, rates.halves, progress.advance)
    if lengths:
        path = live_along(machine, start, lengths)
    elif jump is not None:
        path = live_by_jumps(machine, start, cycles, float(jump))
    else:
        path = live(machine, start, cycles, accuracy, _first_step(rates, rate, cycles))
    return WearLife(
        rates.problem,
        tuple(Stage(node, node.rate.settled) for node in path.nodes),
        cells,
        rates.worn,
        rates.checks(),
        cycles,
        accuracy if jump is None else np.inf,
        path.ended,
        rates.simulated,
        path.rejected,
    )


def _first_step(rates: Rates, rate: Rate, cycles: float) -> float:
    """How many of the `cycles` the first step is long."""
    deepest = float(rate.wear[: rates.count].max(initial=0.0))
    depth = FIRST_DEPTH * _smallest_clearance(rates.problem.mechanism)
    return max(min(FIRST_SHARE * cycles, depth / deepest if deepest > 0 else cycles), 1.0)


def _smallest_clearance(mechanism: Mechanism) -> float:
    """Of what wears [m]; infinite where none says."""
    clearances = (getattr(joint, "clearance", None) for joint in wearing_in(mechanism).values())
    return min((float(size) for size in clearances if size is not None), default=np.inf)


def check_wear_problem(problem: Problem) -> None:
    """Raises `ValueError` with a sentence for a problem without a life."""
    _check_wears(problem)
    _check_names(problem)


def _check_names(problem: Problem) -> None:
    """Raises `ValueError` where a response is called as what every life tells of."""
    for name in problem.response_names:
        kind = name.partition(" ")[0]
        if kind in (DEPTH, VOLUME):
            raise ValueError(
                f'response "{name}" is called as the {kind} that every life tells of; give it '
                "another name."
            )


def _check_wears(problem: Problem) -> None:
    """Raises `ValueError` where nothing wears, or wear is carried on already."""
    mechanism = problem.mechanism
    problem.integrator.formulation.modelled(mechanism)
    flanks = [name for name, c in mechanism.couplings.items() if c.gives and c.play]
    surfaces = {
        f'{surface} of {"coupling" if name in flanks else "joint"} "{name}"': wearing
        for name, c in wearing_in(mechanism).items()
        if name in flanks or name in mechanism.topology.clearances
        for surface, (_, wearing) in c.maps().items()
    }
    if not surfaces:
        raise ValueError(
            "nothing wears in this mechanism: give a joint with clearance a jaxclear.Wearing, or "
            "the play of a coupling wear."
        )
    for what, wearing in surfaces.items():
        if float(wearing.acceleration) != 1:
            raise ValueError(
                f"the {what} wears with acceleration={float(wearing.acceleration):g}; wear_life "
                "carries wear on by itself: leave it at 1."
            )


class WearLifeSample(AbstractAnswer):
    """Lives of a sample. `values` (samples, variables) are the varied numbers, `lives` the life of
    each sample, None for one without a first cycle, `failed` why, by its index; `seed` of the
    sample."""

    problem: Problem
    values: np.ndarray
    lives: tuple[WearLife | None, ...]
    failed: dict[int, str]
    seed: int = eqx.field(static=True)

    @property
    def ended(self) -> dict[int, str]:
        """Why lives ended before their time, by their index; those that failed at once too."""
        early = {i: life.ended for i, life in enumerate(self.lives) if life and life.ended}
        return dict(sorted((self.failed | early).items()))

    @property
    def warned(self) -> tuple[int, ...]:
        """Indices of the lives whose cycles warn."""
        return tuple(i for i, life in enumerate(self.lives) if life and life.warnings)

    def until(self, name: str, limit: float) -> np.ndarray:
        """Cycles (samples,) until a quantity reaches a limit, as `WearLife.until`; `inf` for lives
        that do not reach it, `nan` for those that failed or ended before."""
        lengths = []
        for life in self.lives:
            cycles = life.until(name, limit).cycles if life else np.nan
            lengths.append(np.nan if life and life.ended and np.isinf(cycles) else cycles)
        return np.array(lengths)

    def sentence(self) -> str:
        """How many lives there are, how many ended early and warn, between which depths they end,
        and how far these are known."""
        there = [life for life in self.lives if life]
        worst = ""
        if there:
            depths = [life.at_end(DEPTH) for life in there]
            worst = f" Depths are {min(depths):.4g} to {max(depths):.4g} m, known to "
            worst += f"{100 * max(life.error for life in there):.2g} % or better."
        return (
            f"{len(self.lives)} lives, {len(self.ended)} ended early, {len(self.warned)} with "
            f"warnings.{worst}"
        )

    def _summary(self):
        return self.sentence()

    def _stated(self):
        over, ended, names = ("life",), self.ended, self.problem.names
        units = self.problem.variable_units
        each = lambda read: [np.nan if life is None else read(life) for life in self.lives]
        columns = {n: Column(over, self.values[:, i], units[i]) for i, n in enumerate(names)}
        first = next(filter(None, self.lives), None)
        if first is not None:
            columns["cycles"] = Column(over, each(lambda life: float(life.cycles[-1])))
            for name, unit in first.quantities.items():
                values = each(lambda life, name=name: life.at_end(name))
                columns[name] = Column(over, values, unit, label=with_unit(name, unit))
            columns["error of depth"] = Column(over, each(lambda life: life.error), "1")
        warnings = [" ".join(life.warnings) if life else "" for life in self.lives]
        columns["ended"] = Column(over, [ended.get(i, "") for i in range(len(self.lives))])
        columns["warnings"] = Column(over, warnings)
        return Stated("wear lives", columns, self.problem, (), {"seed": self.seed})


@answering
def wear_life_sample(
    problem: Problem,
    samples: int = 32,
    *,
    cycles: float = 1e6,
    seed: int = 0,
    accuracy: float = 1e-2,
    max_cycles: int = 12,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> WearLifeSample:
    """Wear over many cycles for a quasi-random sample of a problem's variables.

    A life whose first cycle fails keeps its row, with the reason.

    Args:
        problem: the `Problem`, whose duration is the period.
        samples: number of lives; 32 by default.
        cycles: number of cycles of each; 1e6 by default.
        seed: seed of the random numbers; 0 by default.
        accuracy: relative error of a jump [1], > 0; 0.01 by default.
        max_cycles: largest number of cycles over which a rate is averaged; 12 by default.
        store: folder that keeps each life, from which an interrupted study is continued; None
            (default) for none.
        progress_bar: whether to show the progress; False by default.

    Returns:
        The `WearLifeSample`.

    Raises:
        ValueError: if an argument is wrong.
    """
    check_cycle("what lives", problem)
    check_cycles("wear_life_sample", cycles)
    check_number("accuracy of wear_life_sample", accuracy, above=0)
    check_count("max_cycles of wear_life_sample", max_cycles)
    check_flags("wear_life_sample", progress_bar=progress_bar)
    check_wear_problem(problem)
    values = draw(problem, samples, seed)
    lives: list[WearLife | None] = []
    failed: dict[int, str] = {}
    with open_store(store, "wear lives", problem), progress.bar(progress_bar, "lives"):
        for i, row in enumerate(values):
            try:
                rates = Rates(problem, jnp.asarray(row), Patience(SETTLED, accuracy, max_cycles))
                lives.append(lived(rates, float(cycles), float(accuracy), None))
            except (SimulationError, ValueError) as reason:
                lives.append(None)
                failed[i] = str(reason)
            progress.advance(1 / samples)
    return WearLifeSample(problem, values, tuple(lives), failed, seed)
