"""Studies that are kept chunk by chunk: whatever happens to the process, the samples are those of
the plain study, and no finished chunk is lost."""

import json
import pathlib
import threading

import jax.numpy as jnp
import numpy as np
import pandas
import pytest

import jaxclear as jc
from jaxclear.native import stop
from jaxclear.studies.store import batch
from jaxclear.studies.store.samples import Samples
from jaxclear.studies.store.store import CHUNKS, Store

LIMITS = {"fit": (0.2, 0.9)}


def fit(bore, pin):
    """Not finite where the pin is thicker than the bore: about every tenth sample."""
    return {"fit": jnp.sqrt(bore - pin), "area": bore**2 - pin**2}


def problem(tolerance=0.9, function=fit):
    sizes = {
        "bore": jc.Dimension(10.3, tolerance=tolerance, unit="mm"),
        "pin": jc.Dimension(10.0, jc.distribution.Uniform(0.1), unit="mm"),
    }
    return jc.FunctionProblem(function, sizes, units={"fit": "mm", "area": "mm2"})


@pytest.fixture(scope="module")
def plain():
    return jc.monte_carlo(problem(), 10_000, seed=3)


def kept_at(place):
    """The folder with a whole campaign in it."""
    jc.campaign(problem(), 10_000, folder=place, seed=3, chunk=4096)
    return place


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return kept_at(tmp_path_factory.mktemp("campaign") / "kept")


def assert_same_study(one, other):
    assert np.array_equal(one.values, other.values)
    for name, own in one.responses.items():
        assert np.array_equal(own, other.responses[name], equal_nan=True)
    assert np.array_equal(one.outcome, other.outcome)


def contents(place):
    """Every file of a folder, by its path; not what those left who were too late to begin."""
    return {
        str(path.relative_to(place)): path.read_bytes()
        for path in sorted(place.rglob("*"))
        if path.is_file() and not path.relative_to(place).parts[0].startswith(".")
    }


def test_a_campaign_is_the_plain_study_bit_for_bit(plain, folder):
    """Read with its problem and without."""
    found = jc.open_campaign(folder, problem())
    assert_same_study(found.sample, plain)
    assert found.is_complete and found.finished == found.count == 10_000
    assert len(plain.failed) > 100 and np.array_equal(found.failed, plain.failed)
    assert found.sentence() == plain.sentence()
    assert found.rerun(7) == {name: own[7] for name, own in plain.responses.items()}
    alone = jc.open_campaign(folder)
    for one in (found, alone):
        pandas.testing.assert_frame_equal(one.summary(LIMITS), plain.summary(LIMITS))
    pandas.testing.assert_frame_equal(alone.table(), plain.table())
    dataset = alone.to_dataset()
    assert dataset["bore"].attrs["units"] == dataset["fit"].attrs["units"] == "mm"
    assert dataset["area"].attrs["units"] == "mm2" and dataset.attrs["seed"] == 3
    assert np.array_equal(dataset["fit"], plain.responses["fit"], equal_nan=True)
    assert np.array_equal(dataset["scrambling"], plain.to_dataset()["scrambling"])
    (versions,) = json.loads(dataset.attrs["versions"])
    assert {"jaxclear", "jax", "python"} <= set(versions)
    assert 'distribution of "bore"' in json.loads(dataset.attrs["problem"])
    with pytest.raises(ValueError, match="opened without its problem"):
        alone.rerun(0)


def test_chunks_and_scramblings_are_the_users(plain, tmp_path):
    """Files are of another size; samples are the same. Other scramblings are another sample."""
    found = jc.campaign(problem(), 10_000, folder=tmp_path / "a", seed=3, chunk=5000)
    assert found.plan.chunk == 8192
    assert_same_study(found.sample, plain)
    asked = {"sampling": "random", "scramblings": 4, "seed": 1}
    found = jc.campaign(problem(), 500, folder=tmp_path / "b", **asked)
    assert_same_study(found.sample, jc.monte_carlo(problem(), 500, **asked))


def test_an_interrupted_campaign_goes_on(plain, folder, tmp_path, monkeypatch):
    """Ctrl-C after a chunk: that one is kept, a sentence says so, and the same call finishes."""
    place = tmp_path / "kept"
    write = Samples.write

    def interrupted(self, number, values, found):
        write(self, number, values, found)
        stop()

    monkeypatch.setattr(batch, "threads_of", lambda: 1)
    with monkeypatch.context() as patched:
        patched.setattr(Samples, "write", interrupted)
        with pytest.raises(KeyboardInterrupt, match=r"1 of 3 chunks \(of 4096 samples\) are kept"):
            jc.campaign(problem(), 10_000, folder=place, seed=3, chunk=4096)
    partly = jc.open_campaign(place)
    assert partly.finished == 4096 and not partly.is_complete
    assert "not complete: 4096 of 10000 samples are there" in partly.sentence()
    # What is there is a study of as many samples.
    fewer = jc.monte_carlo(problem(), 4096, seed=3)
    assert_same_study(partly.sample, fewer)
    pandas.testing.assert_frame_equal(partly.summary(LIMITS), fewer.summary(LIMITS))
    assert int((partly.to_dataset()["outcome"] == -1).sum()) == 10_000 - 4096
    written = []
    monkeypatch.setattr(Samples, "write", lambda *a: (written.append(a[1]), write(*a)))
    assert_same_study(
        jc.campaign(problem(), 10_000, folder=place, seed=3, chunk=4096).sample, plain
    )
    assert sorted(written) == [1, 2]
    assert contents(place) == contents(folder)


@pytest.mark.parametrize("writes", range(5))
def test_a_file_that_was_not_written_whole_counts_for_nothing(
    folder, tmp_path, monkeypatch, writes
):
    """The end comes after so many files; the next one has half of its bytes."""
    place, replace, count = tmp_path / "kept", pathlib.Path.replace, iter(range(100))

    def ends(self, target):
        if next(count) >= writes:
            self.write_bytes(self.read_bytes()[: self.stat().st_size // 2])
            raise SystemExit
        return replace(self, target)

    with monkeypatch.context() as patched:
        patched.setattr(pathlib.Path, "replace", ends)
        patched.setattr(pathlib.Path, "unlink", lambda *_, **__: None)
        patched.setattr(batch, "threads_of", lambda: 1)
        with pytest.raises(SystemExit):
            jc.campaign(problem(), 10_000, folder=place, seed=3, chunk=4096)
    if writes:
        assert jc.open_campaign(place).finished == min(4096 * (writes - 1), 10_000)
    jc.campaign(problem(), 10_000, folder=place, seed=3, chunk=4096)
    assert contents(place) == contents(folder)


def test_two_at_one_folder_share_its_chunks(plain, folder, tmp_path):
    """Each chunk is computed once; both wait for the other's and end with all samples."""
    place = tmp_path / "kept"
    found = []
    ask = lambda: found.append(jc.campaign(problem(), 10_000, folder=place, seed=3, chunk=4096))
    others = [threading.Thread(target=ask) for _ in range(2)]
    for other in others:
        other.start()
    for other in others:
        other.join()
    assert [one.finished for one in found] == [10_000] * 2
    assert_same_study(found[0].sample, plain)
    assert contents(place) == contents(folder)


def test_claims_that_another_takes_away_are_nobodys(monkeypatch, folder):
    """pathlib finds the folder there, and where it looks whether it is one, not any more."""

    def away(self, **_):
        raise FileExistsError(17, "File exists", str(self))

    samples = Samples.open(folder)
    monkeypatch.setattr(pathlib.Path, "mkdir", away)
    with samples.store.claim(samples.address(0)) as mine:
        assert not mine


def test_another_problem_is_refused_with_what_differs(folder, tmp_path):
    kept = {"folder": folder, "seed": 3, "chunk": 4096}
    for sentence, ask in {
        'distribution of "bore".standard_deviation is 0.3': lambda: jc.campaign(
            problem(0.8), 10_000, **kept
        ),
        'distribution of "bore"': lambda: jc.open_campaign(folder, problem(0.8)),
        "with seed=3, not 4": lambda: jc.campaign(problem(), 10_000, folder=folder, seed=4),
        "with samples=10000, more than 9999": lambda: jc.campaign(problem(), 9999, **kept),
        "with scramblings=8, not 4": lambda: jc.campaign(
            problem(), 20_000, folder=folder, seed=3, scramblings=4
        ),
        "holds no campaign": lambda: jc.open_campaign(tmp_path),
    }.items():
        with pytest.raises(ValueError, match=sentence):
            ask()
    (tmp_path / "diary").write_text("mine")
    with pytest.raises(ValueError, match="is not empty and holds no campaign"):
        jc.campaign(problem(), 100, folder=tmp_path)
    with pytest.raises(TypeError, match='no argument "samplng".*Did you mean'):
        jc.campaign(problem(), 100, folder=tmp_path / "new", samplng="sobol")


def test_chunks_of_other_versions_warn(folder, monkeypatch):
    now = {"jax": "99.0"}
    monkeypatch.setattr("jaxclear.studies.store.samples.library_versions", lambda: now)
    with pytest.warns(UserWarning, match=r"jax 0\S* then, 99.0 now"):
        jc.campaign(problem(), 10_000, folder=folder, seed=3, chunk=4096)


def test_any_study_goes_on_where_it_was_interrupted(tmp_path, monkeypatch):
    """Half of what it asks is computed, then the process ends; the other half follows."""
    asked = jc.FunctionProblem(
        lambda a, b: a**2 * b, {n: jc.Dimension(2.0, jc.distribution.Normal(0.1)) for n in "ab"}
    )
    plain = jc.sensitivity(asked, sample=64, difference_samples=32)
    computed = []
    run, write = batch.Program.run, Store.write

    def counted(*arguments, **options):
        computed.append(1)
        return run(*arguments, **options)

    def ends(self, *own):
        if len(computed) == 2:
            raise SystemExit
        write(self, *own)

    monkeypatch.setattr(batch.Program, "run", counted)
    monkeypatch.setattr(batch, "threads_of", lambda: 1)
    ask = {"sample": 64, "difference_samples": 32, "store": tmp_path / "kept"}
    with monkeypatch.context() as patched:
        patched.setattr(Store, "write", ends)
        with pytest.raises(SystemExit):
            jc.sensitivity(asked, **ask)
    found = jc.sensitivity(asked, **ask)
    assert str(found.table()) == str(plain.table())
    # The second set of samples was lost.
    whole = len(list((tmp_path / "kept" / CHUNKS).iterdir()))
    assert whole >= 3 and len(computed) == whole + 1
    jc.sensitivity(asked, **ask)
    assert len(computed) == whole + 1
    other = jc.FunctionProblem(lambda a, b: a * b, asked.variables)
    with pytest.raises(ValueError, match="of another problem: function is"):
        jc.sensitivity(other, **ask)
