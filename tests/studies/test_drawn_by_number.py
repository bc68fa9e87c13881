"""A sample's values are those of its number, whatever part of a study is drawn."""

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.studies.sampling import MANY, draw, groups


@pytest.mark.parametrize("sampling", ["sobol", "random"])
def test_a_sample_is_drawn_by_its_number(sampling):
    """Within a scrambling, over several of unequal length, at both ends."""
    plain = jc.FunctionProblem(
        lambda a, b: a + b,
        {name: jc.Dimension(1.0, jc.distribution.Normal(0.1)) for name in "ab"},
    )
    whole = draw(plain, 1003, 7, sampling, 13)
    assert len(whole) == len(groups(1003, 13)) == 1003
    for span in ((0, 1), (70, 170), (903, 1003)):
        assert np.array_equal(draw(plain, 1003, 7, sampling, 13, span), whole[slice(*span)])


def test_many_samples_are_drawn_by_their_numbers_too():
    """By a program of another shape for each span, whatever they follow: the same last digits, and
    but for these what a small sample has."""
    kinds = {
        "normal": jc.distribution.Normal(0.1),
        "uniform": jc.distribution.Uniform(0.1),
        "triangular": jc.distribution.Triangular(low=-0.1, high=0.2),
        "lognormal": jc.distribution.Lognormal(median=0.3, spread=0.4),
        "within": jc.distribution.TruncatedNormal(0.1, bound=0.2),
    }
    plain = jc.FunctionProblem(
        lambda **own: own["normal"], {name: jc.Dimension(2.0, own) for name, own in kinds.items()}
    )
    whole = draw(plain, MANY + 5, 7, "sobol", 2)
    for span in ((0, 1), (8000, 8303), (MANY - 6, MANY + 5)):
        assert np.array_equal(draw(plain, MANY + 5, 7, "sobol", 2, span), whole[slice(*span)])
    few = draw(plain, 2048, 7, "sobol", 1)
    np.testing.assert_allclose(whole[:2048], few, rtol=1e-14)
