"""Derivatives of what hardly a sample decides are refused, and each method has a sample of its
own."""

import importlib
import re

import numpy as np
import pytest
from scipy import stats

import jaxclear as jc
from jaxclear.studies.sampling import draw

D = jc.distribution
SUM = jc.FunctionProblem(
    lambda a, b: a + 0.1 * b, {n: jc.Dimension(0.0, D.Normal(1.0)) for n in "ab"}
)


def of_the_sum(asked):
    return next(iter(jc.sensitivity(SUM, "a", of=[asked]).derivatives.values()))


RARE = {
    "0": (("above", 3.5), ("below", -3.5), ("below", 3.5)),
    r"0\.26": (("quantile", 0.999), ("quantile", 0.001)),
}


@pytest.mark.parametrize("deciding", RARE)
def test_what_hardly_a_sample_decides_has_no_derivative(deciding):
    """Both methods found 0 +- 0 of a share, and agreed."""
    for asked in RARE[deciding]:
        found = of_the_sum(asked)
        assert not found.trustworthy and np.isnan([found.value, found.error]).all()
        assert re.search(f"only {deciding} of 256 samples decide it, and 4 should", found.verdict)
        assert all("jaxclear.reliability" in own.refusal for own in found.estimates.values())


def test_what_many_samples_decide_has_a_derivative():
    spread = np.sqrt(1.01)
    found = of_the_sum(("above", 1.0))
    assert found.trustworthy
    assert abs(found.value - stats.norm.pdf(1.0 / spread) / spread) <= found.error


def test_a_refusal_of_one_method_is_told_with_the_answer_of_the_other():
    """Of the sample 5 are beyond, of that for differences half as many; as many as the refusal
    names would do."""
    asked = ("quantile", 0.98)
    found = of_the_sum(asked)
    assert not found.trustworthy and found.method == "regression"
    assert re.search(r"only 2\.6 of 128 samples decide it", found.verdict)
    named = re.search(r"take about difference_samples=(\d+)", found.verdict)
    enough = {"difference_samples": int(named[1]), "methods": ("differences",)}
    (found,) = jc.sensitivity(SUM, "a", of=[asked], **enough).derivatives.values()
    assert np.isfinite(found.estimates["differences"].error)


def test_every_method_draws_a_sample_of_its_own(monkeypatch):
    """No point of it is in a study by a seed nearby."""
    own, kept = importlib.import_module("jaxclear.studies.sensitivity.sensitivity"), []
    run = own.moved
    monkeypatch.setattr(own, "moved", lambda p, s, *a, **k: kept.append(s[0]) or run(p, s, *a, **k))
    jc.sensitivity(SUM, "a", sample=32, difference_samples=16, seed=0)
    assert len(kept) == 1
    for seed in range(5):
        assert not np.isin(kept[0], draw(SUM, 32, seed, scramblings=8)).any()
