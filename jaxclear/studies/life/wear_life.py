"""The wear of a machine over its life: `jaxclear.wear_life`.

A cycle is simulated, what it wears carried on over as many cycles as an error control allows, and
so on, each cycle from where the one before settled. One program is compiled for the whole life:
worn surfaces are an input of it.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import check_count, check_flags, check_number
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.simulation import progress
from jaxclear.simulation.simulate import SimulationError
from jaxclear.studies.ledger.ledger import Ledger
from jaxclear.studies.life.cycle import as_problem
from jaxclear.studies.life.rates import Rates
from jaxclear.studies.life.result import DEPTH, VOLUME, Stage, WearLife
from jaxclear.studies.life.settled import check_period
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
from jaxclear.studies.texts import in_texts

# Ends of a cycle this far apart are the same, as in `settled`.
SETTLED = 1e-3
# The first step wears at most this share of the smallest clearance, in at most this share of the
# life.
FIRST_DEPTH, FIRST_SHARE = 0.1, 0.25


@answering
def wear_life(
    asked: Mechanism | Problem,
    period: float | None = None,
    *,
    cycles: float = 1e6,
    accuracy: float = 1e-2,
    jump: float | None = None,
    most: int = 12,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> WearLife:
    """The wear of a life of so many `cycles`, from few simulated ones: of a mechanism and its
    `period` [s], as in `settled`, or of a `Problem` whose duration is the period and whose
    responses are followed, at its nominal numbers.

    Steps are as long as lets each be wrong by `accuracy` [1] of what it wears, and so the whole
    life (root mean square over the cells of a surface); `jump` [cycles] gives them a fixed length
    instead, each with the rate at its start. The rate is that of a periodic cycle (`settled`);
    where none comes it is a mean over as many as bring its noise below that, `most` at the
    most, and what noise is left belongs to the error. With `most` of 32 or more such cycles run
    eight side by side from the second rate on, by a program of their own: once that is compiled
    (15 s for the 3RSR), each takes a third of the time. `store`: a folder that keeps every
    cycle; asked again, the life goes on from there. A cycle that fails ends the life, with what was
    reached and why. Raises `ValueError` with a sentence for what cannot be asked, and
    `SimulationError` where the very first cycle fails.
    """
    problem = as_problem("wear_life", asked, period)
    check_number("cycles of wear_life", cycles, above=0)
    check_number("accuracy of wear_life", accuracy, above=0)
    if jump is not None:
        check_number("jump of wear_life", jump, at_least=1)
    check_count("most of wear_life", most)
    check_flags("wear_life", progress_bar=progress_bar)
    check_asked(problem)
    kept = None if store is None else Ledger.opened(store, "a wear life", in_texts(problem))
    rates = Rates(problem, problem.nominal(), Patience(SETTLED, accuracy, most), kept)
    with progress.bar(progress_bar, "wear life"):
        result = lived(rates, float(cycles), float(accuracy), jump)
    if kept is not None:
        kept.conclude(result.to_dataset())
    return result


def lived(
    rates: Rates,
    cycles: float,
    accuracy: float,
    jump: float | None,
    lengths: Sequence[Length] = (),
) -> WearLife:
    """The life, and what is kept of it; by steps of these `lengths` if they are given."""
    row, cells = rates.first_row, rates.cells
    try:
        rate = rates.evaluate(row, set_down=rates.problem.state.motion is None)
    except CycleFailed as reason:
        raise SimulationError(f"The life has no first cycle: {reason}", rates.last_run) from None
    check_period("wear_life", rates.problem, rate.settled.last)
    start = Node.first(row, rate, cells)
    machine = Machine(rates.evaluate, rates.carry, cells, rates.halves, progress.advance)
    if lengths:
        found = live_along(machine, start, lengths)
    elif jump is not None:
        found = live_by_jumps(machine, start, cycles, float(jump))
    else:
        found = live(machine, start, cycles, accuracy, _first_step(rates, rate, cycles))
    return WearLife(
        rates.problem,
        tuple(Stage(node, node.rate.settled) for node in found.nodes),
        cells,
        rates.worn,
        rates.checks(),
        cycles,
        accuracy if jump is None else np.inf,
        found.ended,
        rates.simulated,
        found.rejected,
    )


def _first_step(rates: Rates, rate: Rate, cycles: float) -> float:
    """How many of the `cycles` the first step is long."""
    deepest = float(rate.wear[: rates.count].max(initial=0.0))
    room = FIRST_DEPTH * _smallest_clearance(rates.problem.mechanism)
    return max(min(FIRST_SHARE * cycles, room / deepest if deepest > 0 else cycles), 1.0)


def _smallest_clearance(mechanism: Mechanism) -> float:
    """Of the joints that wear [m]; infinite where none says."""
    joints = (mechanism.connections[name].joint for name in mechanism.topology.clearances)
    known = (getattr(joint, "clearance", None) for joint in joints if joint.maps())
    return min((float(size) for size in known if size is not None), default=np.inf)


def check_asked(problem: Problem) -> None:
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
    problem.integrator.formulation.seen(mechanism)
    surfaces = {
        f'{surface} of joint "{name}"': wearing
        for name in mechanism.topology.clearances
        for surface, (_, wearing) in mechanism.connections[name].joint.maps().items()
    }
    if not surfaces:
        raise ValueError(
            "nothing wears in this mechanism: give a joint with clearance a jaxclear.Wearing."
        )
    for what, wearing in surfaces.items():
        if float(wearing.acceleration) != 1:
            raise ValueError(
                f"the {what} wears with acceleration={float(wearing.acceleration):g}; wear_life "
                "carries wear on by itself: leave it at 1."
            )
