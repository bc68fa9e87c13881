"""Folders of studies that a disk or a person has damaged, that nothing can be written into."""

import errno
import json
import shutil
import threading
import time
from pathlib import Path

import filelock
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.studies.store import batch
from jaxclear.studies.store.samples import Samples
from jaxclear.studies.store.store import CHUNKS, STUDY, Store, StoreError, compute_address
from tests.rigs.cells import slow_but
from tests.studies.test_campaign import contents, kept_at, problem


def ask_for_campaign(place, samples=10_000):
    return jc.campaign(problem(), samples, folder=place, seed=3, chunk=4096)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return kept_at(tmp_path_factory.mktemp("campaign") / "kept")


@pytest.fixture
def folder(whole, tmp_path):
    return Path(shutil.copytree(whole, tmp_path / "kept"))


@pytest.fixture
def computed(monkeypatch):
    """Values of all chunks that are computed."""
    found, run = [], batch.Program.run
    counted = lambda *own, **how: (found.append(own[1]), run(*own, **how))[1]
    monkeypatch.setattr(batch.Program, "run", counted)
    return found


def flipped(content, share):
    """One bit, at this share of the file."""
    changed = bytearray(content)
    changed[int(share * (len(content) - 1))] ^= 4
    return bytes(changed)


# By the content of a chunk and that of another one.
DAMAGES = {
    "deleted": None,
    "garbage": lambda content, _: b"nothing that anybody wrote" * 40,
    "empty": lambda content, _: b"",
    "half": lambda content, _: content[: len(content) // 2],
    "a bit of what it tells": lambda content, _: flipped(content, 60 / len(content)),
    "a bit of its values": lambda content, _: flipped(content, 0.1),
    "a bit of its responses": lambda content, _: flipped(content, 0.8),
    "another chunk": lambda _, other: other,
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_chunk_is_computed_again_and_said(whole, folder, computed, name):
    """Opened, it is not counted; asked again, the folder is what it was, byte for byte."""
    files = Samples.open(folder)
    first, path = (files.store.path(files.address(i)) for i in (0, 1))
    if name == "deleted":
        path.unlink()
    else:
        path.write_bytes(DAMAGES[name](path.read_bytes(), first.read_bytes()))
    found = jc.open_campaign(folder)
    assert not found.is_complete and found.finished == 10_000 - 4096
    said = f"1 of 3 chunks in .*kept are missing or do not match .*{path.name}.*computed again"
    with pytest.warns(UserWarning, match=said):
        assert ask_for_campaign(folder).is_complete
    assert [len(own) for own in computed] == [4096]
    assert contents(folder) == contents(whole)


def test_every_flipped_bit_is_seen_or_does_no_harm(folder):
    """At 300 places of a file: its numbers are right, or it counts for nothing."""
    files = Samples.open(folder)
    path = files.store.path(files.address(2))
    content, right = path.read_bytes(), files.chunk(2)
    seen = 0
    for share in np.linspace(0, 1, 300):
        path.write_bytes(flipped(content, share))
        found = files.chunk(2)
        seen += found is None
        if found is not None:
            assert found.about == right.about and found.arrays.keys() == right.arrays.keys()
            for name, own in found.arrays.items():
                assert np.array_equal(own, right.arrays[name], equal_nan=True)
    assert seen > 290


def test_what_is_damaged_while_it_is_read_is_named(folder):
    found = jc.open_campaign(folder)
    path = found._samples.store.path(found._samples.address(0))
    path.write_bytes(flipped(path.read_bytes(), 0.5))
    with pytest.raises(ValueError, match=f"{path.name} is missing or does not match its checksum"):
        found.summary()


@pytest.mark.parametrize("damage", [lambda text: text[:-9], lambda text: text.replace("1", "2")])
def test_a_damaged_plan_is_written_again(whole, folder, computed, damage):
    (folder / STUDY).write_text(damage((folder / STUDY).read_text()))
    with pytest.raises(ValueError, match=r"study.json does not match its checksum; ask the same"):
        jc.open_campaign(folder)
    with pytest.warns(UserWarning, match="study.json does not match its checksum; it is written"):
        ask_for_campaign(folder)
    assert not computed and contents(folder) == contents(whole)


def test_a_damaged_file_of_a_kept_study_is_computed_again(tmp_path, computed):
    jc.sweep(problem(), {"pin": [9.9, 10.0, 10.1]}, store=tmp_path)
    path = min((tmp_path / CHUNKS).iterdir())
    content = path.read_bytes()
    path.write_bytes(flipped(content, 0.5))
    computed.clear()
    with pytest.warns(UserWarning, match=f"{path.name} does not match its checksum"):
        jc.sweep(problem(), {"pin": [9.9, 10.0, 10.1]}, store=tmp_path)
    assert len(computed) == 1 and path.read_bytes() == content


def full(*_, **__):
    raise OSError(errno.ENOSPC, "No space left on device")


def read_only(*_, **__):
    raise OSError(errno.EROFS, "Read-only file system")


def test_a_full_disk_costs_nothing_that_is_finished(whole, tmp_path, monkeypatch):
    place, write, count = tmp_path / "kept", Path.write_bytes, iter(range(100))
    monkeypatch.setattr(batch, "threads_of", lambda: 1)
    with monkeypatch.context() as patched:
        fills = lambda *own: full() if next(count) >= 3 else write(*own)
        patched.setattr(Path, "write_bytes", fills)
        said = r"written into the folder .*kept \(No space left on device\).*make room, ask the sam"
        with pytest.raises(StoreError, match=said):
            ask_for_campaign(place)
    assert jc.open_campaign(place).finished == 2 * 4096
    assert ask_for_campaign(place).is_complete
    assert contents(place) == contents(whole)


def test_a_finished_folder_that_is_read_only_answers(folder, monkeypatch, computed):
    before = contents(folder)
    for kind, name in ((Path, "write_bytes"), (Path, "mkdir"), (filelock.FileLock, "acquire")):
        monkeypatch.setattr(kind, name, read_only)
    assert ask_for_campaign(folder).is_complete
    assert jc.open_campaign(folder, problem()).rerun(3)
    assert len(jc.open_campaign(folder).to_dataset()["fit"].to_numpy()) == 10_000
    said = r"\(Read-only file system\). What was finished is kept there; let it be written, ask"
    with pytest.raises(StoreError, match=said):
        ask_for_campaign(folder, 20_000)
    assert contents(folder) == before and not computed


def test_arrays_of_any_type_and_shape_are_read_as_they_were_written(tmp_path):
    arrays = {
        "scalar": np.array(2.0),
        "none": np.zeros((3, 0)),
        "truths": np.array([True, False, True]),
        "codes": np.arange(5, dtype=np.int8),
        "columns": np.arange(6.0).reshape(2, 3).T,
        "not finite": np.array([np.nan, -np.inf]),
    }
    store = Store(tmp_path)
    store.write("a", arrays, {"samples": 3})
    found = Store(tmp_path).read("a")
    assert found.about == {"samples": 3} and list(found.arrays) == list(arrays)
    for name, own in arrays.items():
        there = found.arrays[name]
        assert there.dtype == own.dtype and there.shape == own.shape
        assert there.tobytes() == own.tobytes() and there.flags.aligned
    assert store.read("b") is None


def write_plan(folder, plan):
    folder.mkdir(parents=True, exist_ok=True)
    plan.pop("checksum", None)
    (folder / STUDY).write_text(json.dumps(plan | {"checksum": compute_address(plan)}))


def test_folders_of_other_versions_are_refused_in_a_sentence(tmp_path):
    """Of jaxclear 0.35 or 0.36, whose files have no format; and of a later one."""
    write_plan(tmp_path / "whole", {"what": "a Monte Carlo campaign", "plan": {}, "problem": "{}"})
    ask_for_campaign(tmp_path / "later")
    saved = json.loads((tmp_path / "later" / STUDY).read_text())
    write_plan(tmp_path / "later", saved | {"format": 99})
    for folder in tmp_path.iterdir():
        before = contents(folder)
        for ask in (
            jc.open_campaign,
            ask_for_campaign,
            lambda place: jc.sweep(problem(), {"pin": [9.9, 10.0]}, store=place),
        ):
            with pytest.raises(ValueError, match="by another version of jaxclear, whose files"):
                ask(folder)
        assert contents(folder) == before


ROUGH = {n: jc.Dimension(2.0, jc.distribution.Normal(0.1)) for n in "ab"}


def rough(factor=1.0):
    """No program that a surface stands in for."""
    return jc.FunctionProblem(lambda a, b: factor * a**2 * b, ROUGH)


STUDIES = {
    "sweep": lambda p, **how: jc.sweep(p, {"a": [1.9, 2.0]}, **how),
    "screening": lambda p, **how: jc.screening(p, 4, **how),
    "worst_case": lambda p, **how: jc.worst_case(p, samples=16, **how),
    "monte_carlo": lambda p, **how: jc.monte_carlo(p, 64, **how),
    "sensitivity": lambda p, **how: jc.sensitivity(
        p, sample=64, difference_samples=16, methods=("regression", "pathwise"), **how
    ),
    "sobol_indices": lambda p, **how: jc.sobol_indices(p, 16, **how),
    "shapley_effects": lambda p, **how: jc.shapley_effects(p, 32, **how),
    "surface": lambda p, **how: jc.surface(p, 32, **how),
    "corrected_statistics": lambda p, **how: jc.corrected_statistics(jc.surface(p, 32), 8, **how),
    "multi_fidelity": lambda p, **how: jc.multi_fidelity(p, rough(0.9), 256, **how),
    "reliability": lambda p, **how: jc.reliability(
        p, jc.limit_state.Above("response", 9.0), most_runs=400, **how
    ),
    "design": lambda p, **how: jc.design(
        p,
        {"a": jc.cost.Reciprocal(1.0)},
        jc.limit.MeanAndDeviation("response", at_most=9.0, deviations=3),
        tolerance={"a": (0.05, 0.5)},
        settings=jc.DesignSettings(samples=64, surface=True),
        **how,
    ),
}


LONG = "corrected_statistics", "reliability", "design"


@pytest.mark.parametrize("name", slow_but([n for n in STUDIES if n not in LONG], STUDIES))
def test_every_study_takes_what_it_asks_from_its_store(name, tmp_path, computed):
    """The answer is that without one; the second time nothing is computed."""
    study = STUDIES[name]
    plain, alone = study(rough()), len(computed)
    kept = study(rough(), store=tmp_path)
    assert len(computed) > alone
    computed.clear()
    again = study(rough(), store=tmp_path)
    # The surface that is corrected has no store here.
    assert len(computed) == (2 if name == "corrected_statistics" else 0)
    assert str(again) == str(kept)
    if name != "multi_fidelity":
        assert str(plain) == str(kept), "of several models: costs are measured anew"
    before = contents(tmp_path)
    with pytest.raises(ValueError, match="holds .*, not a life; give another one"):
        Store.open(tmp_path, "a life", {})
    assert contents(tmp_path) == before


def at_once(ask, count):
    """Threads that ask together."""
    threads = [threading.Thread(target=ask) for _ in range(count)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()


def test_two_at_one_folder_share_the_chunks_of_any_study(tmp_path, computed, monkeypatch):
    """Each set of samples is computed once. What has no runs has no store."""
    monkeypatch.setattr(batch, "PATIENCE", 0.01)
    found, study = [], lambda name: STUDIES["worst_case"](rough(), store=tmp_path / name)
    study("alone")
    alone = len(computed)
    computed.clear()
    at_once(lambda: found.append(str(study("both"))), 2)
    assert len(computed) == alone and len(set(found)) == 1
    assert contents(tmp_path / "both") == contents(tmp_path / "alone")
    with pytest.raises(ValueError, match="it must be a problem, for its store"):
        jc.sobol_indices(jc.surface(rough(), 32), store=tmp_path)


def test_who_waits_for_a_chunk_gets_what_the_other_one_computed(tmp_path):
    """As two processes do that follow the same life, cycle by cycle."""
    computed, found = [], []

    def ask():
        store = Store(tmp_path)
        load = lambda: store.read("cycle")

        def compute():
            computed.append(1)
            time.sleep(0.05)
            store.write("cycle", {"wear": np.arange(3.0)})
            return store.read("cycle")

        found.append(store.obtain("cycle", load, compute, wait=True).arrays["wear"])

    at_once(ask, 4)
    assert len(computed) == 1 and len(found) == 4
    assert all(np.array_equal(own, np.arange(3.0)) for own in found)
