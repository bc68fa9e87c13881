"""What studies found as xarray Datasets: of samples, of derivatives, of extremes and shares, each
by the names of its responses and variables.

What a study looks like is told by its own class; here are only the arrays.
"""

from typing import Any

import numpy as np

from jaxclear.ground.datasets import Column, dataset, of_table
from jaxclear.studies.base import AbstractProblem
from jaxclear.studies.texts import in_texts

__all__ = [
    "FINER",
    "finer_name",
    "of_corners",
    "of_corrected",
    "of_derivatives",
    "of_design",
    "of_effects",
    "of_indices",
    "of_reliability",
    "of_rows",
    "of_samples",
    "of_surface",
]

RESPONSE, VARIABLE = "response", "variable"
# What responses of replicas are, which are those of the first samples.
FINER = "of a finer run of the same sample"


def finer_name(response: str) -> str:
    """What the responses of replicas are called."""
    return f"finer {response}"


def of_samples(study: Any) -> Any:
    """Of a `MonteCarlo`: variables and responses over the samples."""
    problem, columns = study.problem, {}
    for i, (name, unit) in enumerate(zip(problem.names, problem.variable_units, strict=True)):
        columns[name] = Column(("sample",), study.values[:, i], unit, kind=VARIABLE)
    for name, values in study.responses.items():
        columns[name] = Column(("sample",), values, problem.units()[name], kind=RESPONSE)
    ending = "how a sample ended; 0 is success"
    columns["outcome"] = Column(("sample",), np.asarray(study.outcome), "1", ending)
    columns["ended"] = Column(("sample",), study.ended, "s", "when it ended")
    parts = "independent part of the sample"
    columns["scrambling"] = Column(("sample",), study.scrambling, "1", parts)
    for check, figure in study.checks.figures.items():
        worst = np.asarray(figure.worst).reshape(study.count, -1).max(axis=1)
        meaning = f"worst figure of this check, whose limit is {check.limit:g}"
        columns[f"check {check.name.lower()}"] = Column(("sample",), worst, "1", meaning)
    if study.replicas is not None:
        for name, values in study.replicas.responses.items():
            columns[finer_name(name)] = Column(("replica",), values, problem.units()[name], FINER)
    told = {"result": study.sentence(), "seed": study.seed, "chunk": study.chunk}
    return dataset(columns, what="Monte Carlo", problem=in_texts(problem), **told)


def _of_pairs(
    what: str, problem: AbstractProblem, pairs: dict[str, dict[tuple[str, str], Any]], **said: Any
) -> Any:
    """Numbers or texts by name, each by (response, variable); nan and "" where there is none."""
    keys = list(dict.fromkeys(key for own in pairs.values() for key in own))
    firsts, seconds = (list(dict.fromkeys(key[i] for key in keys)) for i in (0, 1))
    columns = {}
    for name, own in pairs.items():
        texts = any(isinstance(value, str) for value in own.values())
        empty = "" if texts else np.nan
        values = [[own.get((one, other), empty) for other in seconds] for one in firsts]
        array = np.array(values, str if texts else float)
        columns[name] = Column((RESPONSE, VARIABLE), array)
    return dataset(
        columns,
        {RESPONSE: Column((RESPONSE,), firsts), VARIABLE: Column((VARIABLE,), seconds)},
        what=what,
        problem=in_texts(problem),
        **said,
    )


def _warnings(study: Any) -> dict[str, str]:
    """Of what runs of a study warn, as text that goes with its data."""
    return {"warnings": " ".join(study.warnings)}


def of_derivatives(study: Any) -> Any:
    """Of a `Sensitivity`: the answers, and those of each method."""
    found = study.derivatives
    pairs: dict[str, dict] = {
        "derivative": {key: own.value for key, own in found.items()},
        "error": {key: own.error for key, own in found.items()},
        "unit": {key: study.unit(*key) for key in found},
        "method": {key: own.method for key, own in found.items()},
        "verdict": {key: own.verdict for key, own in found.items()},
        "trustworthy": {key: float(own.trustworthy) for key, own in found.items()},
    }
    for method in dict.fromkeys(m for own in found.values() for m in own.estimates):
        own = {key: one.estimates[method] for key, one in found.items() if method in one.estimates}
        pairs[f"{method}"] = {key: one.value for key, one in own.items()}
        pairs[f"{method} error"] = {key: one.error for key, one in own.items()}
        pairs[f"{method} refusal"] = {key: one.refusal for key, one in own.items()}
    return _of_pairs("sensitivity", study.sample.problem, pairs, samples=study.sample.count)


def of_effects(study: Any) -> Any:
    """Of `ShapleyEffects`."""
    pairs = {
        "effect": {key: one.value for key, one in study.effects.items()},
        "effect low": {key: one.low for key, one in study.effects.items()},
        "effect high": {key: one.high for key, one in study.effects.items()},
    }
    said = {"runs": study.runs, "failed": study.failed, "remark": study.remark}
    said |= _warnings(study)
    return _of_pairs("Shapley effects", study.problem, pairs, **said)


def of_indices(study: Any) -> Any:
    """Of `SobolIndices`."""
    pairs = {}
    for name, own in (("first order", study.first), ("total", study.total)):
        pairs[name] = {key: one.value for key, one in own.items()}
        pairs[f"{name} low"] = {key: one.low for key, one in own.items()}
        pairs[f"{name} high"] = {key: one.high for key, one in own.items()}
    said = {"runs": study.runs, "failed": study.failed} | _warnings(study)
    return _of_pairs("Sobol' indices", study.problem, pairs, **said)


def of_corrected(study: Any) -> Any:
    """Of a `Corrected`."""
    columns = of_table(study.table(), RESPONSE)
    limits = list(study.probabilities)
    for i, name in enumerate(("probability", "probability error", "probability gain")):
        values = [study.probabilities[limit][i] for limit in limits]
        columns[name] = Column(("limit",), np.array(values, float), "1")
    coordinates = {
        RESPONSE: Column((RESPONSE,), list(study.means)),
        "limit": Column(("limit",), np.array(limits, str)),
    }
    said = {"result": study.sentence(), "runs": study.runs, "failed": study.failed}
    said |= _warnings(study)
    parts = in_texts(study.surface.problem)
    return dataset(columns, coordinates, what="corrected statistics", problem=parts, **said)


def of_rows(
    what: str, dimension: str, table: Any, problem: AbstractProblem | None = None, **said: Any
) -> Any:
    """A table of a study: a column for each of its own, over its rows, which its index names."""
    named = table.index.name is not None
    coordinates = {dimension: Column((dimension,), table.index.to_numpy())} if named else {}
    parts = None if problem is None else in_texts(problem)
    return dataset(of_table(table, dimension), coordinates, what=what, problem=parts, **said)


def of_corners(study: Any) -> Any:
    """Of a `WorstCase`: the ends of every response, and where they are met."""
    problem, ends = study.problem, {"least": study.least, "largest": study.largest}
    names = list(study.nominal)
    over = (RESPONSE, "end")
    grid = lambda read: np.array([[read(own[name]) for own in ends.values()] for name in names])
    variable = lambda values, meaning: Column((VARIABLE,), values, "", meaning)
    columns = {
        "value": Column(over, grid(lambda one: one.value), "", "found by runs"),
        "first order": Column(over, grid(lambda one: one.first_order), "", "by slopes"),
        "place": Column((*over, VARIABLE), grid(lambda one: one.values), "", "where it is met"),
        "nominal": Column((RESPONSE,), [study.nominal[name] for name in names]),
        "low": variable(study.low, "end of the box"),
        "high": variable(study.high, "end of the box"),
        "unit": Column((RESPONSE,), [problem.units()[name] for name in names]),
        "variable unit": Column((VARIABLE,), list(problem.variable_units)),
    }
    coordinates = {
        RESPONSE: Column((RESPONSE,), names),
        "end": Column(("end",), list(ends)),
        VARIABLE: Column((VARIABLE,), list(problem.names)),
    }
    said = {"runs": study.runs, "points": study.points, "failed": len(study.failed)}
    said |= _warnings(study)
    return dataset(columns, coordinates, what="worst case", problem=in_texts(problem), **said)


def of_surface(surface: Any) -> Any:
    """Of a `ResponseSurface`: the runs behind it, its coefficients and how good it is."""
    problem = surface.problem
    units, names = problem.units(), list(problem.response_names)
    columns = {}
    for i, (name, unit) in enumerate(zip(problem.names, problem.variable_units, strict=True)):
        columns[name] = Column(("run",), surface.values[:, i], unit, kind=VARIABLE)
    for name in names:
        columns[name] = Column(("run",), surface.responses[name], units[name], kind=RESPONSE)
        told = "what the other runs say of it"
        columns[f"{name} predicted"] = Column(
            ("run",), surface.predictions[name], units[name], told
        )
    coefficients = np.array([np.asarray(surface.coefficients[name]) for name in names])
    columns["coefficient"] = Column((RESPONSE, "term"), coefficients)
    columns["power"] = Column(("term", VARIABLE), np.asarray(surface.powers), "1")
    columns["quality"] = Column(
        (RESPONSE,), [surface.quality[name] for name in names], "1", "leave-one-out R2"
    )
    columns["degree"] = Column((RESPONSE,), [surface.degrees[name] for name in names], "1")
    return dataset(
        columns,
        {RESPONSE: Column((RESPONSE,), names), VARIABLE: Column((VARIABLE,), list(problem.names))},
        what="response surface",
        problem=in_texts(problem),
        result=surface.sentence(),
        failed=surface.failed,
        **_warnings(surface),
    )


def of_reliability(study: Any) -> Any:
    """Of a `Reliability`: each method's answer, and the design points."""
    problem = study.problem
    methods = study.table()
    columns = of_table(methods, "method")
    count, names = len(study.points), list(problem.names)
    places = [[study.design_point(i)[name] for name in names] for i in range(count)]
    columns["beta"] = Column(("point",), [point.beta for point in study.points], "1")
    place = np.array(places).reshape(count, len(names))
    columns["design point"] = Column(("point", VARIABLE), place, "", "likeliest part that fails")
    columns["variable unit"] = Column((VARIABLE,), list(problem.variable_units))
    own = study.importance()
    shares = [own.get(name, np.nan) for name in names]
    columns["importance"] = Column((VARIABLE,), shares, "1", "of the likeliest design point")
    coordinates = {
        "method": Column(("method",), list(methods.index)),
        VARIABLE: Column((VARIABLE,), names),
    }
    said = {"limit": study.limit.words(), "result": study.sentence(), "runs": study.runs}
    said |= {"stands": study.method}
    return dataset(columns, coordinates, what="reliability", problem=in_texts(problem), **said)


def of_design(found: Any) -> Any:
    """Of a `Design`: variables, limits, and the rounds of the search."""
    columns = of_table(found.table().drop(columns="variable"), VARIABLE)
    limits = of_table(found.limit_table().drop(columns="limit"), "limit")
    columns |= {f"limit {name}": own for name, own in limits.items()}
    history = of_table(found.history(), "round")
    columns |= {f"round {name}": own for name, own in history.items()}
    coordinates = {
        VARIABLE: Column((VARIABLE,), list(found.table()["variable"])),
        "limit": Column(("limit",), [limit.words() for limit in found.limits]),
    }
    said = {"result": found.sentence(), "cost": found.cost, "runs": found.runs}
    return dataset(columns, coordinates, what="design", problem=in_texts(found.problem), **said)
