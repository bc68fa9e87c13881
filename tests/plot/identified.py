"""An identification that is made up: a figure reads the same of it."""

import numpy as np

from jaxclear.studies.identification.regression import predict as regressed
from jaxclear.studies.identification.regression import regression
from jaxclear.studies.identification.result import (
    Evidence,
    Identified,
    prior_quantiles,
    unknown_of,
)


def identified(own):
    """What a record tells of a problem with two unknowns, the first of which it knows."""
    rng = np.random.default_rng(0)
    shares = rng.random((128, 2))
    statistics = shares[:, :1] + 0.02 * rng.standard_normal((128, 5))
    fitted = regression(statistics, shares)
    here = statistics[0] + 0.01
    joint = np.clip(fitted.estimates(here)[0] + fitted.missed(fitted.estimates(here)[0]), 0, 1)
    rows = [
        unknown_of(own, name, (one.estimate, one.low, one.high))
        for name, one in zip(own.names, regressed(fitted, here), strict=True)
    ]
    values = [prior_quantiles(own, name, joint[:, i]) for i, name in enumerate(own.names)]
    kinds = {"a: levels": (statistics[:, :4], here[:4]), "a: peaks": (statistics[:, 4:], here[4:])}
    evidence = Evidence(fitted, kinds, joint)
    drawn = np.stack(values, axis=1)
    return Identified(own, tuple(rows), drawn, 128, 0, "by 5 statistics", (), 0.4, evidence)
