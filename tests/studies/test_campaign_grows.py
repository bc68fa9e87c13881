"""Campaigns that are asked for more samples, or for an accuracy: they go on from what is there, and
end as one that was asked for all of it at once."""

from pathlib import Path

import numpy as np
import pandas
import pytest

import jaxclear as jc
from jaxclear.studies.store.batch import Program
from jaxclear.studies.store.samples import Samples
from jaxclear.studies.store.store import CHUNKS
from jaxclear.studies.store.workers import Evaluation, done
from tests.studies.test_campaign import LIMITS, assert_same_study, contents, problem

ASKED = {"seed": 3, "chunk": 4096, "scramblings": 8}


def campaign(samples, folder, **how):
    return jc.campaign(problem(), samples, folder=folder, **ASKED | how)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    place = tmp_path_factory.mktemp("whole") / "kept"
    campaign(10_000, place)
    return place


@pytest.fixture
def written(monkeypatch):
    """Numbers of the chunks that are written."""
    found, write = [], Samples.write
    monkeypatch.setattr(Samples, "write", lambda *own: (found.append(own[1]), write(*own)))
    return found


def test_more_samples_go_on_from_those_that_are_there(whole, tmp_path, written):
    """Through parts of batches and of chunks: the same bytes as from one call."""
    place = tmp_path / "kept"
    for samples, chunks in ((100, [0]), (5000, [0, 1]), (8192, [1]), (10_000, [2]), (10_000, [])):
        written.clear()
        found = campaign(samples, place)
        assert sorted(written) == chunks
        assert found.finished == found.count == samples
    assert_same_study(found.sample, jc.monte_carlo(problem(), 10_000, seed=3))
    assert contents(place) == contents(whole)


def test_what_ends_before_its_first_chunk_is_not_complete(tmp_path, monkeypatch):
    """Killed while the chunks that are there are still being checked."""
    campaign(5000, tmp_path)

    def killed(samples):
        raise SystemExit

    with monkeypatch.context() as patched:
        patched.setattr(Samples, "finished", killed)
        with pytest.raises(SystemExit):
            campaign(10_000, tmp_path)
    found = jc.open_campaign(tmp_path, problem())
    assert found.count == 10_000 and not found.is_complete
    assert "The campaign is not complete" in found.sentence()


def test_an_earlier_look_at_a_folder_stays_what_it_was(tmp_path):
    before = campaign(5000, tmp_path)
    values = before.values
    campaign(10_000, tmp_path)
    again = jc.open_campaign(tmp_path, problem())
    assert before.finished == 5000 and again.finished == 10_000
    assert np.array_equal(again.values[:5000], values)
    with pytest.raises(ValueError, match=r"with samples=10000, more than 5000\. Ask for as many"):
        campaign(5000, tmp_path)


@pytest.mark.parametrize("late_is_first", [True, False])
def test_who_is_at_a_chunk_that_is_to_have_more_samples_harms_nobody(
    whole, tmp_path, late_is_first
):
    """A process that began before another one asked for more is at the last chunk."""
    campaign(5000, tmp_path)
    late = Samples.open(tmp_path)
    late.store.path(late.address(1)).unlink()
    late._done.clear()
    late.extend(10_000, 4096)
    if not late_is_first:
        campaign(10_000, tmp_path)
    assert done(late, Evaluation(Program(problem()), late.plan), 1) is not None
    campaign(10_000, tmp_path)
    assert contents(tmp_path) == contents(whole)


def test_who_has_finished_leaves_alone_what_others_write_for_more_samples(
    whole, tmp_path, monkeypatch
):
    """A process at the earlier plan tidies up while another one is about to rename a file."""
    campaign(4096, tmp_path)
    early, replace, tidied = Samples.open(tmp_path), Path.replace, []

    def slow(self, target):
        if CHUNKS in str(target) and not tidied:
            tidied.append(1)
            early.conclude()
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", slow)
    campaign(10_000, tmp_path)
    assert tidied and contents(tmp_path) == contents(whole)


def test_what_no_chunk_is_finished_of_says_so(tmp_path):
    campaign(5000, tmp_path)
    for path in (tmp_path / CHUNKS).iterdir():
        path.unlink()
    unfinished = jc.open_campaign(tmp_path)
    for ask in (
        lambda: unfinished.sample,
        unfinished.table,
        lambda: unfinished.mean("fit"),
        lambda: jc.sensitivity(problem(), sample=unfinished),
    ):
        with pytest.raises(ValueError, match="no sample of the campaign in .* is finished yet"):
            ask()
    assert str(unfinished) == "None of 5000 samples is finished yet.", "print must not raise"


def test_an_accuracy_decides_how_many_samples_there_are(tmp_path, written, monkeypatch):
    """As of the plain study; interrupted between, it goes on from what is there."""
    asked = {"accuracy": {"area": 0.02}, "seed": 3}
    plain = jc.monte_carlo(problem(), 65_536, **asked)
    assert 512 < plain.count < 65_536
    place = tmp_path / "kept"
    extend = Samples.extend

    def ends(self, samples, usual):
        if samples == plain.count:
            raise SystemExit
        return extend(self, samples, usual)

    with monkeypatch.context() as patched:
        patched.setattr(Samples, "extend", ends)
        with pytest.raises(SystemExit):
            jc.campaign(problem(), 65_536, folder=place, **asked)
    assert jc.open_campaign(place).count == plain.count // 2
    found = jc.campaign(problem(), 65_536, folder=place, **asked)
    assert_same_study(found.sample, plain)
    assert found.sentence() == plain.sentence()
    pandas.testing.assert_frame_equal(found.summary(LIMITS), plain.summary(LIMITS))
    written.clear()
    assert jc.campaign(problem(), 65_536, folder=place, **asked).count == plain.count
    assert not written
    finer = jc.campaign(problem(), 2 * plain.count, folder=place, accuracy={"area": 1e-9}, seed=3)
    assert finer.count == 2 * plain.count
    assert "not reached (mean of area" in finer.sentence()
    with pytest.raises(ValueError, match='no response "areas"'):
        jc.campaign(problem(), folder=place, accuracy={"areas": 1.0})


def test_who_asked_for_fewer_gets_these_where_another_asks_for_more_meanwhile(
    tmp_path, monkeypatch
):
    """It is at its last chunk, which is not full, when the other one comes."""
    write, come = Samples.write, []

    def late(self, number, *own):
        if number == 1 and not come:
            come.append(Samples.open(tmp_path).extend(10_000, 4096))
        write(self, number, *own)

    with monkeypatch.context() as patched:
        patched.setattr(Samples, "write", late)
        found = campaign(5000, tmp_path)
    assert come and found.finished == found.count == found.to_dataset().sizes["sample"] == 5000
    assert_same_study(found.sample, jc.monte_carlo(problem(), 5000, seed=3))
    again = jc.open_campaign(tmp_path)
    assert (again.finished, again.count) == (4096, 10_000)
    assert campaign(10_000, tmp_path).is_complete


def test_a_folder_keeps_its_scramblings_where_none_are_asked_for(tmp_path):
    jc.campaign(problem(), 100, folder=tmp_path, seed=3)
    found = jc.campaign(problem(), 1000, folder=tmp_path, seed=3)
    assert_same_study(found.sample, jc.monte_carlo(problem(), 1000, seed=3, scramblings=8))
    with pytest.raises(ValueError, match="with scramblings=8, not 16"):
        jc.campaign(problem(), 1000, folder=tmp_path, seed=3, scramblings=16)


def test_what_was_to_be_smaller_than_a_batch_grows_in_whole_ones(tmp_path):
    """Begun for an accuracy, with less than a batch at the most."""
    jc.campaign(problem(), 1000, folder=tmp_path, seed=3, accuracy=1e-9)
    plan = jc.campaign(problem(), 5000, folder=tmp_path, seed=3).plan
    assert plan.batch == 4096 and plan.chunk % plan.batch == 0


def test_what_a_chunk_held_that_is_to_have_more_samples_is_not_shown(tmp_path):
    found = campaign(5000, tmp_path)
    found._samples.extend(10_000, 4096)
    dataset = jc.open_campaign(tmp_path).to_dataset()
    assert dataset["outcome"].dtype == np.int8
    assert np.all(dataset["outcome"][4096:] == -1)
    for name in ("bore", "fit", "ended"):
        assert np.all(np.isnan(dataset[name][4096:]))
        assert np.any(np.isfinite(dataset[name][:4096]))
