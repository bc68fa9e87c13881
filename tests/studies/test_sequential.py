"""Samples that grow until their means are known as accurately as asked."""

import itertools

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.studies.sampling import Drawing, groups
from jaxclear.studies.sequential import Grown
from jaxclear.studies.statistics.accuracy import missed_accuracies
from jaxclear.studies.statistics.scrambled import jackknifed
from jaxclear.studies.store import campaign
from jaxclear.studies.store.samples import Samples
from tests.studies.test_campaign import problem


def test_a_sample_that_grew_has_its_place_in_a_chunk_by_its_number():
    """`rerun` runs a sample in that place: chunks of 48 do not end where a growth does."""
    drawing = Drawing(problem(), 3, "sobol", 16)
    places = {}

    def found(values):
        places.update({tuple(own): i % 48 for i, own in enumerate(np.asarray(values))})
        return {"number": np.asarray(values)[:, 0]}

    sample = Grown(drawing, found, 48)
    for count in (256, 512, 1024):
        sample.to(count)
    assert np.array_equal(sample.values, drawing.span(0, 1024))
    assert np.array_equal(sample.result["number"], sample.values[:, 0])
    assert [places[tuple(own)] for own in sample.values] == [i % 48 for i in range(1024)]


def test_an_accuracy_is_judged_alike_whatever_the_pieces():
    """By the error of the mean that the study tells of itself."""
    chance = np.random.default_rng(1)
    response = chance.normal(3.0, 1.0, 1000) + 0.1 * groups(1000, 8)
    response[chance.integers(0, 1000, 30)] = np.nan
    good = np.isfinite(response)
    half = jackknifed(np.mean, response[good], groups(1000, 8)[good]).error
    found = []
    for size in (1000, 300, 7):
        ends = [*range(0, 1000, size), 1000]
        pieces = [({"gap": response[a:b]}, groups(b, 8, a)) for a, b in itertools.pairwise(ends)]
        assert not missed_accuracies(({"gap": 1.001 * half}, False), pieces)
        found.append(missed_accuracies(({"gap": 0.999 * half}, False), pieces)["gap"])
    assert found[0] == found[1] == found[2]
    assert found[0][0] == pytest.approx(half, rel=1e-9)


def test_an_accuracy_is_judged_with_some_chunks_in_memory(tmp_path, monkeypatch):
    """However many there are in the folder."""
    sizes, read = [], Samples.read
    counted = lambda self, at, *n: (sizes.append(at.stop - at.start), read(self, at, *n))[1]
    monkeypatch.setattr(campaign, "READ", 4096)
    monkeypatch.setattr(Samples, "read", counted)
    asked = {"accuracy": {"area": 1e-9}, "seed": 3}
    found = jc.campaign(problem(), 16_384, folder=tmp_path, chunk=4096, **asked)
    assert found.count == 16_384 and max(sizes) == 4096
    assert found.sentence() == jc.monte_carlo(problem(), 16_384, **asked).sentence()
