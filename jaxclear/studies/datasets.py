"""What studies found as xarray Datasets: of samples, of derivatives, of extremes and shares, each
by the names of its responses and variables.

What a study looks like is told by its own class; here are only the arrays.
"""

from typing import Any

import numpy as np

from jaxclear.ground.datasets import Column, dataset, of_table
from jaxclear.studies.base import AbstractProblem
from jaxclear.studies.texts import in_texts

RESPONSE = "response"


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
    said |= {"warnings": " ".join(study.warnings)}
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
