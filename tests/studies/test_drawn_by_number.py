"""A sample's values are those of its number, whatever part of a study is drawn, and however large
the study is."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.stats import norm, qmc

import jaxclear as jc
from jaxclear.studies import scrambling
from jaxclear.studies.sampling import BLOCK, draw, groups
from jaxclear.studies.scrambling import ScrambledSequence

MANY = 4 * BLOCK
NORMAL = jc.FunctionProblem(
    lambda a, b: a + b, {name: jc.Dimension(1.0, jc.distribution.Normal(0.1)) for name in "ab"}
)
KINDS = {
    "normal": jc.distribution.Normal(0.1),
    "uniform": jc.distribution.Uniform(0.1),
    "triangular": jc.distribution.Triangular(low=-0.1, high=0.2),
    "lognormal": jc.distribution.Lognormal(median=0.3, spread=0.4),
    "within": jc.distribution.TruncatedNormal(0.1, bound=0.2),
}


@pytest.mark.parametrize("sampling", ["sobol", "random"])
def test_a_sample_is_drawn_by_its_number(sampling):
    """Scramblings of unequal length, in any order, at both ends; of any number of samples."""
    whole = draw(NORMAL, 1003, 7, sampling, 13)
    assert len(whole) == len(groups(1003, 13)) == 1003
    for span in ((0, 1), (70, 170), (903, 1003), (5, 5)):
        assert np.array_equal(draw(NORMAL, 1003, 7, sampling, 13, span), whole[slice(*span)])
    assert np.array_equal(draw(NORMAL, 300, 7, sampling, 13), whole[:300])
    assert len(np.unique(whole[:, 0])) == 1003


def test_scramblings_of_sobols_sequence_take_turns():
    """By scipy's own sequence: sample i is point i // 4 of scrambling i % 4."""
    shares = norm.cdf((draw(NORMAL, 250, 7, scramblings=4) - 1.0) / 0.1)
    for i in range(4):
        rng = np.random.default_rng((7, i) if i else 7)
        points = qmc.Sobol(2, rng=rng).random_base2(6)
        own = shares[groups(250, 4) == i]
        np.testing.assert_allclose(own, points[: len(own)], rtol=1e-9)


def test_points_are_scipys_bit_for_bit():
    for dimensions, seed in ((1, 0), (5, 3), (40, 1)):
        points = qmc.Sobol(dimensions, rng=np.random.default_rng(seed)).random_base2(10)
        own = ScrambledSequence(dimensions, np.random.default_rng(seed))
        assert np.array_equal(own.points(0, 1024), points)
        assert np.array_equal(own.points(300, 701), points[300:701])


def test_points_are_the_same_where_scipy_has_moved_its_table(monkeypatch):
    own = ScrambledSequence(5, np.random.default_rng(3)).points(300, 701)

    def missing(dimensions):
        raise FileNotFoundError

    monkeypatch.setattr(scrambling, "_direction_bits", missing)
    moved = ScrambledSequence(5, np.random.default_rng(3))
    assert np.array_equal(moved.points(300, 701), own)
    assert np.array_equal(moved.points(0, 5)[1:], moved.points(1, 5))


def test_more_than_the_sequence_has_is_refused_in_a_sentence():
    with pytest.raises(ValueError, match="21202 random numbers each.*at most 21201"):
        ScrambledSequence(21_202, np.random.default_rng(0))
    one = ScrambledSequence(1, np.random.default_rng(0))
    assert one.points(2**30 - 1, 2**30).shape == (1, 1)
    with pytest.raises(ValueError, match="1073741825 samples of one sequence, which has 2.30"):
        one.points(2**30, 2**30 + 1)


def test_a_sample_and_its_derivatives_import_no_scipy_stats():
    """Its import takes longer than a small study."""
    program = """
import sys
import jaxclear as jc
one = jc.FunctionProblem(lambda a: a * a, {"a": jc.Dimension(1.0, jc.distribution.Normal(0.1))})
sample = jc.monte_carlo(one, 128)
str(sample.summary()), str(sample)
jc.sensitivity(one, "a", sample=sample)
assert "scipy.stats" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=300)


def test_many_samples_are_drawn_by_their_numbers_too():
    """Whatever they follow: the same last digits. The first ones are those of a small study."""
    asked = {name: jc.Dimension(2.0, own) for name, own in KINDS.items()}
    plain = jc.FunctionProblem(
        lambda **own: own["normal"], asked, correlation={("normal", "uniform"): 0.5}
    )
    whole = draw(plain, MANY + 5, 7, "sobol", 2)
    for span in ((0, 1), (8000, 8303), (MANY - 6, MANY + 5)):
        assert np.array_equal(draw(plain, MANY + 5, 7, "sobol", 2, span), whole[slice(*span)])
    assert np.array_equal(draw(plain, 2049, 7, "sobol", 2), whole[:2049])
    # What follows is of the same distribution.
    for values in (whole[:MANY], draw(plain, 2 * MANY, 7, "sobol", 2)[MANY:]):
        np.testing.assert_allclose(values[:, :2].mean(axis=0), 2.0, atol=1e-3)
