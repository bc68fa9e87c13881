"""A sample that is there serves other studies: of the same problem, in memory or in a folder."""

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.native import stop
from jaxclear.studies.store import batch
from jaxclear.studies.store.samples import Samples


def problem(width=0.1):
    return jc.FunctionProblem(
        lambda a, b: a**2 * b, {n: jc.Dimension(2.0, jc.distribution.Normal(width)) for n in "ab"}
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("given") / "kept"
    jc.campaign(problem(), 256, folder=place, seed=3)
    return place


def test_a_campaign_tells_the_derivatives_that_its_samples_tell(folder):
    """Opened with its problem or without; closed forms: d mean / da = 2 E[a b], d/db = E[a^2]."""
    plain = jc.monte_carlo(problem(), 256, seed=3)
    told = jc.sensitivity(problem(), sample=plain, difference_samples=16)
    for campaign in (jc.open_campaign(folder), jc.open_campaign(folder, problem())):
        found = jc.sensitivity(problem(), sample=campaign, difference_samples=16)
        assert str(found.table()) == str(told.table())
    slopes = [own.value for own in found.derivatives.values()]
    np.testing.assert_allclose(slopes, [8.0, 4.01], rtol=5e-3)


def test_a_surface_is_fitted_to_a_campaign(folder):
    found = jc.surface(problem(), sample=jc.open_campaign(folder))
    at = np.array([2.1, 1.9])
    assert abs(float(found(at)["response"]) - 2.1**2 * 1.9) < 1e-6


def test_what_is_told_of_an_unfinished_campaign_says_so(folder, tmp_path, monkeypatch):
    """Interrupted after the first of three chunks."""
    write = Samples.write

    def interrupted(self, number, values, found):
        write(self, number, values, found)
        stop()

    monkeypatch.setattr(batch, "threads_of", lambda: 1)
    monkeypatch.setattr(Samples, "write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        jc.campaign(problem(), 10_000, folder=tmp_path / "kept", seed=3, chunk=4096)
    for place, partly in ((tmp_path / "kept", True), (folder, False)):
        sample = jc.open_campaign(place, problem())
        derived = jc.sensitivity(problem(), "a", sample=sample, difference_samples=16)
        said = [jc.surface(problem(), sample).sentence()]
        said += [own.verdict for own in derived.derivatives.values()]
        told = "not complete: 4096 of 10000 samples are there"
        assert [told in own for own in said] == [partly] * 2


def test_a_sample_of_another_problem_is_refused(folder):
    other = problem(0.2)
    campaign, plain = jc.open_campaign(folder), jc.monte_carlo(problem(), 64)
    for study in (jc.sensitivity, jc.surface):
        with pytest.raises(
            ValueError, match='campaign in .* problem: distribution of "a".*Give a sample'
        ):
            study(other, sample=campaign)
        with pytest.raises(ValueError, match='of another problem .distribution of "a"'):
            study(other, sample=plain)
