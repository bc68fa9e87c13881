"""The sample that a record is compared with: runs of the problem with its unknowns, and the laws,
drawn from their priors, as the record's sensors would see them.

What is kept are signals without noise, at the record's sampling: sensing them anew, with other
numbers of the instruments, needs no run.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxclear.ground.arguments import expect
from jaxclear.ground.wording import listed
from jaxclear.integrators import NonColliding, Outcome
from jaxclear.results.signal import Signal, by_turns, full_turns
from jaxclear.studies.experiment import SampleResult
from jaxclear.studies.identification.laws import Ensemble
from jaxclear.studies.identification.measurement import Measurement
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_experiment import RunExperiment
from jaxclear.studies.sampling import Drawing, usual_scramblings
from jaxclear.studies.sensor import check_sensor
from jaxclear.studies.store.batch import chunk_size, evaluate_all

# Turns that statistics of turns need.
LEAST_TURNS = 3
# Samples of a turn, at the least and the most, in whole parts of the bins of phase.
LEAST_SAMPLES, MOST_SAMPLES, BINS = 32, 4096, 32


class Sample(NamedTuple):
    """Runs of a problem. `values` (runs, variables of the asked problem), `choices` by name the
    number (runs,) of the law that acted, `signals` (runs, samples) by name, without noise, and how
    many runs failed."""

    problem: Problem
    values: np.ndarray
    choices: dict[str, np.ndarray]
    signals: dict[str, np.ndarray]
    failed: int
    laws: Ensemble


def watched(problem: Problem, record: Measurement, laws: Ensemble) -> Problem:
    """The problem whose responses are the noiseless signals of a record's sensors.

    Args:
        problem: with the unknowns as variables.
        record: with sensors and rate.
        laws: alternatives of the laws, drawn as further variables.
    """
    intervals = round(float(problem.duration) * record.rate)
    variables = {name: problem.variables[name] for name in problem.names} | laws.variables
    correlation = None
    if problem.correlation is not None:
        count = len(problem.names)
        correlation = np.eye(len(variables))
        correlation[:count, :count] = np.asarray(problem.correlation)
    sensors = {_response_name(name): sensor.ideal() for name, sensor in record.sensors.items()}
    watched_problem = Problem(
        laws.mechanism,
        dict.fromkeys(sensors, _end_time),
        variables,
        duration=intervals / record.rate,
        integrator=problem.integrator,
        save=intervals + 1,
        state=problem.state,
        correlation=correlation,
    )
    # No study but this one knows what to do with signals.
    return eqx.tree_at(lambda tree: tree.response, watched_problem, sensors)


def _end_time(run: Any) -> Any:
    return run.time[-1]


def _response_name(name: str) -> str:
    return f"signal {name}"


def check_identifiable(problem: Any, record: Measurement) -> None:
    """Raises `ValueError` with a sentence where a problem's runs cannot be compared with a record,
    or cannot see what is asked."""
    expected = "a jaxclear.Problem of a mechanism in time, its unknowns as variables"
    expect(problem, Problem, "what is identified", expected)
    expect(problem.experiment, RunExperiment, "what is identified", expected)
    if not problem.variables:
        raise ValueError("the problem has no variables; its unknowns are these: give it some.")
    several = [name for name, members in problem.groups.items() if len(members) > 1]
    if several:
        raise ValueError(
            f'"{several[0]}" is a variable of several numbers; give each unknown a variable of its '
            "own, so that each has an interval."
        )
    if isinstance(problem.integrator, NonColliding):
        raise ValueError(
            "integrator.NonColliding moves bodies as ideal joints do, whatever the clearance, so "
            "that no record of motion tells a clearance by it; take one in whose runs journals "
            "leave their bearings, such as FixedStep() or Adaptive()."
        )
    for name, sensor in record.sensors.items():
        check_sensor(name, sensor, problem.mechanism)
    lasts = float(problem.duration)
    if record.lasts > lasts * (1 + 1e-6):
        raise ValueError(
            f"the record lasts {record.lasts:.6g} s and the problem's runs {lasts:.6g} s; give the "
            "problem a longer duration (what is beyond the record, at the beginning, lets the "
            f"motion settle), or take record.part({record.time[0]:.6g}, "
            f"{record.time[0] + lasts:.6g})."
        )


def window_end(problem: Problem, record: Measurement) -> int | None:
    """Where in a run's samples what a record shows ends: before what was cut off the record, or, of
    a run that is too short for that, as many whole turns later as it takes; None where no whole
    turns do."""
    margin = round(float(problem.duration) * record.rate) + 1 - len(record.time)
    cut = round(record.cut_off * record.rate)
    if cut > margin and record.turn is not None and not isinstance(record.turn, str):
        cut = round(_time_to_full_turn(record) * record.rate)
    elif cut > margin:
        # What tells its turns itself, or has none, has no place in a run.
        cut = 0
    return len(record.time) + margin - cut if cut <= margin else None


def _time_to_full_turn(record: Measurement) -> float:
    """Time [s] from the end of a record to the end of a whole turn of what it is a part of."""
    turn = float(record.turn or 0.0)
    # A whole turn but for rounding is one.
    return max(record.cut_off - turn * np.floor(record.cut_off / turn + 1e-6), 0.0)


def check_window(problem: Problem, record: Measurement) -> None:
    """Raises `ValueError` with a sentence where a record ends within a turn at which no run of the
    problem shows as much."""
    if window_end(problem, record) is None:
        end_time = record.time[-1] + _time_to_full_turn(record)
        raise ValueError(
            f"the record ends {record.cut_off:.6g} s before what it is a part of, within a turn, "
            f"and the problem's runs are too short to be compared there; end its part at a whole "
            f"turn, such as {end_time:.6g} s, or give the problem a longer duration."
        )


@eqx.filter_jit
def _signals_of_chunk(problem: Problem, values: Array) -> SampleResult:
    """Outcomes of a chunk of samples, whose responses are signals: a store keeps them as they
    are."""
    return jax.vmap(problem.evaluate)(values)


def sampled(
    problem: Problem,
    record: Measurement,
    base_problem: Problem,
    ensemble: Ensemble,
    runs: int,
    seed: int = 0,
    progress_bar: bool = False,
) -> Sample:
    """Runs of the problem over its priors, as signals.

    Args:
        problem: with the unknowns as variables.
        record: with the sensors.
        base_problem: the problem that is run (`watched`).
        ensemble: alternatives of the laws.
        runs: number of runs.
        seed: of the sample.
        progress_bar: whether one is shown.
    """
    drawing = Drawing(base_problem, seed, "sobol", usual_scramblings(runs))
    values = drawing.span(0, runs)
    chunk = chunk_size(base_problem, runs)
    results = evaluate_all(
        base_problem,
        jnp.asarray(values),
        chunk=chunk,
        progress_bar=progress_bar,
        label="identify",
        function=_signals_of_chunk,
    )
    signals = {name: np.asarray(results.responses[_response_name(name)]) for name in record.sensors}
    good = np.asarray(results.outcome) == Outcome.REACHED
    for signal in signals.values():
        good &= np.all(np.isfinite(signal), axis=1)
    count = len(problem.names)
    choices = {name: values[good, count + i] for i, name in enumerate(ensemble.variables)}
    successful = {name: signal[good] for name, signal in signals.items()}
    return Sample(problem, values[good, :count], choices, successful, int(np.sum(~good)), ensemble)


class Cut(NamedTuple):
    """How signals are cut: by how many whole `turns` and `samples` a turn (0: nothing turns), the
    same for the record and all runs."""

    turns: int
    samples: int


def cut_of(record: Measurement, sample: Sample) -> Cut:
    """How many turns all have. Raises `ValueError` where they are too few."""
    if record.turn is None:
        return Cut(0, 0)
    if isinstance(record.turn, str):
        simulated = _matching_part(sample.problem, sample.signals[record.turn], record)
        angles = [record.signals[record.turn], *simulated]
        ends = [full_turns(angle) for angle in angles]
        turns = min(last - first for first, last in ends)
    else:
        turns = int(np.floor(record.lasts / record.turn * (1 + 1e-9)))
    if turns < LEAST_TURNS:
        raise ValueError(
            f"the record and the problem's runs have {max(turns, 0)} whole turns in common; "
            f"statistics of turns need {LEAST_TURNS}: record longer, or leave turn out."
        )
    if isinstance(record.turn, str):
        angle = record.signals[record.turn]
        each = 2 * np.pi * len(angle) / abs(angle[-1] - angle[0])
    else:
        each = record.turn * record.rate
    samples = int(np.clip(BINS * round(each / BINS), LEAST_SAMPLES, MOST_SAMPLES))
    return Cut(turns, samples)


def _matching_part(problem: Problem, signals: np.ndarray, record: Measurement) -> np.ndarray:
    """What of the runs stands beside the record: as many samples, at their end or before what was
    cut off the record."""
    end = window_end(problem, record)
    assert end is not None
    return signals[:, end - len(record.time) : end]


def as_signals(signals: dict[str, np.ndarray], record: Measurement, cut: Cut) -> dict[str, Signal]:
    """Signals as statistics take them, without that of the encoder.

    Args:
        signals: by sensor, shape (runs, samples).
        record: with rate, and encoder or period of turns.
        cut: number of turns, and samples in each.
    """
    result = {}
    for name, signal in signals.items():
        if name == record.turn:
            continue
        if cut.turns == 0:
            result[name] = Signal(signal, record.rate)
            continue
        if isinstance(record.turn, str):
            angle = signals[record.turn]
        else:
            angle = 2 * np.pi / float(record.turn or 1) * np.arange(signal.shape[1]) / record.rate
        result[name] = by_turns(signal, record.rate, angle, cut.turns, cut.samples)
    return result


def sensed(sample: Sample, record: Measurement, seed: int) -> dict[str, np.ndarray]:
    """Readings of the record's sensors for each run, over the time of the record.

    The angle that indicates turns is taken without noise.

    Args:
        sample: noiseless signals of the runs.
        record: with the sensors.
        seed: of their noise.
    """
    rng = np.random.default_rng((seed, 1))
    result = {}
    for name, signal in sample.signals.items():
        output = signal
        if name != record.turn:
            output = record.sensors[name].sensed(signal, record.rate, rng)
        result[name] = _matching_part(sample.problem, output, record)
    return result


def statistics_of(signals: dict[str, Signal], statistics: Any) -> dict[str, np.ndarray]:
    """Statistics (runs, numbers) of each kind, by the signal's name and their own. Raises
    `ValueError` with a sentence where one's own gives something else."""
    result = {}
    for name, signal in signals.items():
        for what, function in statistics.items():
            values = np.asarray(function(signal), float)
            if values.ndim != 2 or len(values) != len(signal.values):
                raise ValueError(
                    f'statistic "{what}" gives an array of shape {values.shape} for signals of '
                    f"shape {signal.values.shape}; it must be (signals, numbers)."
                )
            result[f"{name}: {what}"] = values
    if not result:
        raise ValueError(f"there is no signal beside the encoder's, {listed(signals)}.")
    return result
