"""What is compared with what: each model of a machine, as it ran in each record, and the record.

A model is a problem, or a function that makes it for a record, where what drives the machine was
measured with it.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from jaxclear.ground.arguments import check_name, expect
from jaxclear.ground.wording import described, listed
from jaxclear.studies.function_problem import Dimension, FunctionExperiment
from jaxclear.studies.identification.forward import Forward, Record
from jaxclear.studies.identification.laws import Ensemble
from jaxclear.studies.identification.measurement import Measurement
from jaxclear.studies.identification.sample import (
    check_identifiable,
    check_window,
    watched,
    window_end,
)
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_experiment import RunExperiment
from jaxclear.studies.sensor import AbstractSensor, Series, filter_signal

Model: TypeAlias = Problem | Callable[[Measurement], Problem]
# The model that is asked about where there is only one.
ALONE = "the model"


def models_of(
    models: Model | Mapping[str, Model], records: Sequence[Measurement]
) -> dict[str, list[Problem]]:
    """By name of each model its problem for each record. Raises `ValueError` with a sentence for
    what is none."""
    every = models if isinstance(models, Mapping) else {ALONE: models}
    if not every:
        raise ValueError("identify is given no model; it must have a problem at least.")
    return {name: [_made(name, m, record) for record in records] for name, m in every.items()}


def compared_records(
    models: Model | Mapping[str, Model], records: Sequence[Measurement]
) -> list[Measurement]:
    """Records without what was given to the machine; those that problems were made for show what
    these do up to their end."""
    every = models.values() if isinstance(models, Mapping) else [models]
    made = any(not isinstance(model, Problem) for model in every)
    result = [record.compared for record in records]
    return [dataclasses.replace(record, cut_off=0.0) for record in result] if made else result


def only_one(models: Mapping[str, list[Problem]]) -> list[Any]:
    """The problems of the one model that statistics take. Raises `ValueError` for several."""
    if len(models) > 1:
        raise ValueError(
            f'how="statistics" takes one problem and is given {listed(models)}; several models by '
            'name are for how="signal".'
        )
    return next(iter(models.values()))


def same_sensing(one: Measurement, other: Measurement) -> bool:
    """Whether the same sample serves two records."""
    is_same = one.sensors.keys() == other.sensors.keys() and one.rate == other.rate
    is_same = is_same and len(one.time) == len(other.time) and one.turn == other.turn
    is_same = is_same and one.cut_off == other.cut_off
    return is_same and all(
        bool(eqx.tree_equal(sensor, other.sensors[name])) for name, sensor in one.sensors.items()
    )


def _made(name: str, model: Any, record: Measurement) -> Problem:
    value = model
    if callable(model) and not isinstance(model, Problem):
        value = model(record)
    if not isinstance(getattr(value, "experiment", None), (RunExperiment, FunctionExperiment)):
        raise ValueError(
            f"what is identified, {name}, is {described(value)}; it must be a jaxclear.Problem or "
            "a jaxclear.FunctionProblem, or a function that makes one for a Measurement."
        )
    return value


def compared(problem: Problem, record: Measurement) -> tuple[Forward, Record]:
    """A problem as a function that gives a record's signals. Raises `ValueError` with a sentence
    where it cannot."""
    for name, sensor in record.sensors.items():
        for number in ("noise", "gain", "bandwidth", "delay"):
            if isinstance(getattr(sensor, number), Dimension):
                raise ValueError(
                    f'the {number} of signal "{name}" varies; how="signal" takes instruments whose '
                    'numbers are known: give one number, or ask how="statistics".'
                )
        if sensor.sampling is not None:
            raise ValueError(
                f'signal "{name}" has a sampling of its own; how="signal" takes signals as the '
                'record has them: leave sampling out, or ask how="statistics".'
            )
    noise = {name: float(sensor.noise) or None for name, sensor in record.sensors.items()}
    row = Record(record.signals, noise)
    return _make_forward(problem, record), row


def _make_forward(problem: Problem, record: Measurement) -> Forward:
    names, sensors = tuple(record.signals), dict(record.sensors)
    rate = jnp.asarray(record.rate)
    if isinstance(problem.experiment, FunctionExperiment):
        for name, sensor in sensors.items():
            expect(sensor, Series, f'the sensor of signal "{name}"', "a jaxclear.sensor.Series")
            check_name(
                "series",
                getattr(sensor, "name", ""),
                problem.series_names,
                " in what the function gives",
            )
        return Forward(problem, _OfFunction(sensors, rate), names, problem)
    check_identifiable(problem, record)
    check_window(problem, record)
    end = window_end(problem, record)
    assert end is not None
    watch = watched(problem, record, Ensemble(problem.mechanism, {}, {}))
    shown = _OfRun(sensors, rate, slice(end - len(record.time), end))
    return Forward(watch, shown, names, problem)


class _OfFunction(eqx.Module):
    """Signals of a function."""

    sensors: dict[str, Any]
    rate: Array

    def __call__(self, problem: Problem, values: Array) -> dict[str, Array]:
        """Those of one set of values."""
        outputs = problem.answers(problem.setting(values))
        return {n: _read_sensor(sensor, outputs, self.rate) for n, sensor in self.sensors.items()}


class _OfRun(eqx.Module):
    """Signals of a run, of which a record saw the samples `window`."""

    sensors: dict[str, AbstractSensor]
    rate: Array
    window: slice = eqx.field(static=True)

    def __call__(self, problem: Problem, values: Array) -> dict[str, Array]:
        """Those of one set of values; nan where the run did not reach its end."""
        run = problem.started(problem.setting(values))[2]
        last = lambda signal: jnp.where(run.succeeded, signal, jnp.nan)[self.window]
        return {n: last(_read_sensor(sensor, run, self.rate)) for n, sensor in self.sensors.items()}


def _read_sensor(sensor: Any, run: Any, rate: Array) -> Array:
    return filter_signal(sensor(run), rate, sensor.bandwidth, sensor.delay, sensor.gain)
