"""The settled cycle of a machine: `jaxclear.steady_cycle`.

A machine that is set down begins with a motion of its own, a journal that falls through its play.
After some cycles it ends each one as it began it, or it never does: then a cycle is known by means.
"""

import equinox as eqx
import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_flags, check_number
from jaxclear.ground.printing import with_error
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.results.state_history import State
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation import progress
from jaxclear.simulation.simulate import SimulationError
from jaxclear.simulation.wear import Worn
from jaxclear.studies.answer import AbstractAnswer, Column, Stated, with_unit
from jaxclear.studies.life.cycle import (
    as_problem,
    as_state,
    check_period,
    cycle,
    cycle_request,
    first_state,
    restless,
    worst_of,
)
from jaxclear.studies.life.settling import (
    Patience,
    Settling,
    correlation_factor,
    settle,
    standard_error,
    total,
)
from jaxclear.studies.problem import Problem


class SteadyCycle(AbstractAnswer):
    """The settled cycle. `settling` holds all cycles that were run, `run` is the last of them,
    `worn` the surfaces on which each began; `tolerance` [1] as it was asked for.
    """

    problem: Problem
    settling: Settling
    run: Trajectory
    worn: Worn
    tolerance: float = eqx.field(static=True)

    @property
    def periodic(self) -> bool:
        """Whether the last cycle ended as it began, within the tolerance."""
        return self.settling.periodic

    @property
    def cycles(self) -> int:
        """Cycles run."""
        return len(self.settling.cycles)

    @property
    def state(self) -> State:
        """Where the next cycle begins, on the surfaces on which the last one began."""
        return as_state(self.settling.last.end, self.worn)

    @property
    def wear(self) -> Worn:
        """Depth [m] that a cycle wears, by joint and surface: of the last one where the motion is
        periodic, otherwise the mean."""
        return self.settling.wear

    @property
    def noise(self) -> Worn:
        """Standard error of `wear` [m], cell by cell; 0 where the motion is periodic."""
        return self.settling.noise

    @property
    def responses(self) -> dict[str, tuple[float, float]]:
        """Each response of a cycle, and its standard error (0 where the motion is periodic)."""
        return self.settling.responses()

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the cycles that are taken as the motion warn of, each at its worst."""
        return worst_of([one.checks for one in self.settling.taken]).warnings

    def sentence(self) -> str:
        """After how many cycles the motion is periodic, or that it is not, and what then is known
        of its means."""
        last, period = self.settling.last, float(self.problem.duration)
        if last.fault:
            return f"Cycle {self.cycles}: {last.fault}"
        reason = f"{last.worst} is {last.distance:.2g} from where it was a cycle before"
        limit = f"(tolerance {self.tolerance:.2g})"
        if self.periodic:
            count = f"{self.cycles} cycle{'' if self.cycles == 1 else 's'} of {period:.6g} s"
            return f"Periodic after {count}: {reason} {limit}."
        text = f"Not periodic after {self.cycles} cycles of {period:.6g} s: {reason} {limit}."
        means = f"{text} Means are over the last {self.settling.measured} cycles"
        volumes = np.array([total(one) for one in self.settling.taken])
        if not volumes.any():
            return f"{means}."
        error = correlation_factor(volumes) * standard_error(volumes) / volumes.mean()
        return f"{means}; the volume worn in a cycle is known to {100 * error:.2g} % (one sigma)."

    def _summary(self):
        units = self.problem.units()
        means = (
            f'"{name}" of a cycle: {with_error(*mean)} {units[name]}'.removesuffix(" 1")
            for name, mean in self.responses.items()
        )
        return self.sentence(), *means, *self.warnings

    def _stated(self):
        over, units = ("cycle",), self.problem.units()
        every = dict(enumerate(self.settling.cycles, 1))
        each = lambda read: [read(one) for one in every.values()]
        first = self.cycles - self.settling.measured
        columns = {
            "cycle": Column(over, list(every)),
            "apart": Column(over, each(lambda one: one.distance), "1"),
            "most": Column(over, each(lambda one: one.worst)),
            "taken": Column(over, [number > first for number in every]),
        }
        worn = [(j, s) for one in every.values() for j, names in one.volumes.items() for s in names]
        for joint, surface in dict.fromkeys(worn):
            volumes = each(lambda one, j=joint, s=surface: float(one.volumes[j][s]))
            name = f"{joint} {surface}"
            columns[name] = Column(over, volumes, "m^3", label=with_unit(name, "m^3"))
        for name in self.problem.response_names:
            values = each(lambda one, name=name: float(one.responses[name]))
            columns[name] = Column(over, values, units[name], label=with_unit(name, units[name]))
        warnings = self.warnings
        return Stated("settled cycle", columns, self.problem, warnings, labelled=False)


@answering
def steady_cycle(
    subject: Mechanism | Problem,
    period: float | None = None,
    *,
    state: State | None = None,
    tolerance: float = 1e-3,
    cycles: int = 20,
    progress_bar: bool = False,
    throw: bool = True,
) -> SteadyCycle:
    """Run cycle after cycle until one is periodic.

    Each cycle continues the one before; worn surfaces are reset to their depth at the start. A
    cycle is periodic where the states at its two ends differ by at most `tolerance`: positions of
    bodies divided by the longest arm, orientations in rad (whole turns left out), velocities
    divided by the largest of the cycle, journals divided by the clearance. Where none is, the later
    half of the cycles is averaged, with its scatter, as chaotic motion needs.

    Args:
        subject: a `Mechanism`, or a `Problem` whose duration is the period, at its nominal values.
        period: period of a mechanism [s], > 0; None for a problem.
        state: the `State` at the beginning of the first cycle, such as that of
            `jaxclear.resting_state`; None (default) for the mechanism's own.
        tolerance: largest difference [1], > 0; 1e-3 by default.
        cycles: largest number of cycles; 20 by default.
        progress_bar: whether to show the progress; False by default.
        throw: whether a cycle that ends early raises an error; True by default.

    Returns:
        The `SteadyCycle`.

    Raises:
        ValueError: if an argument is wrong, or drives do not repeat after a period.
        SimulationError: if a cycle ends early, unless `throw=False`.
    """
    check_number("tolerance of steady_cycle", tolerance, above=0)
    check_count("cycles of steady_cycle", cycles, 1)
    check_flags("steady_cycle", progress_bar=progress_bar, throw=throw)
    problem = as_problem("steady_cycle", subject, period, cycles, state)
    mechanism, length = problem.mechanism, float(problem.duration)
    values = problem.nominal()
    begin, worn = first_state(problem, values)
    needed = cycle_request(problem, values)
    check_period("steady_cycle", mechanism, float(begin.time), length, cycles)
    runs: list[Trajectory] = []

    def one(motion, surfaces):
        result, run = cycle(needed, motion, surfaces)
        runs[:] = [run]
        progress.advance(1 / cycles)
        return result

    with progress.bar(progress_bar, "settling"):
        ready = lambda c: not restless(mechanism, float(c.end.time) - length, length)
        settling = settle(one, begin, worn, Patience(tolerance, 1.0, cycles), ready)
    modelled = problem.model(problem.setting(values))
    run = eqx.tree_at(lambda r: r.history.mechanism, runs[0], modelled)
    result = SteadyCycle(problem, settling, run, worn, tolerance)
    if settling.last.fault:
        if throw:
            raise SimulationError(result.sentence(), runs[0])
        return result
    check_period("steady_cycle", mechanism, float(settling.last.end.time) - length, length)
    return result
