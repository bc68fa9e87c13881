"""Folders of studies that a disk or a person has damaged, that nothing can be written into."""

import errno
import shutil
from pathlib import Path
from types import SimpleNamespace

import filelock
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.studies.store import batch
from jaxclear.studies.store.files import PIECES, Unwritable
from jaxclear.studies.store.samples import Samples
from jaxclear.studies.store.store import RESULT, STUDY, Ledger
from tests.studies.test_campaign import contents, kept_at, problem


def ask(place, samples=10_000):
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
    monkeypatch.setattr(
        batch.Program, "run", lambda *own, **how: (found.append(own[1]), run(*own, **how))[1]
    )
    return found


def flipped(content, share):
    """One bit, at this share of the file."""
    changed = bytearray(content)
    changed[int(share * (len(content) - 1))] ^= 4
    return bytes(changed)


DAMAGES = {
    "deleted": None,
    "garbage": lambda content: b"nothing that anybody wrote" * 40,
    "empty": lambda content: b"",
    "half": lambda content: content[: len(content) // 2],
    "a bit of what it tells": lambda content: flipped(content, 60 / len(content)),
    "a bit of its values": lambda content: flipped(content, 0.1),
    "a bit of its responses": lambda content: flipped(content, 0.8),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_chunk_is_computed_again_and_said(whole, folder, computed, name):
    """Opened, it is not counted; asked again, the folder is what it was, byte for byte."""
    files = Samples.opened(folder)
    path, damage = files.pieces.path(files.address(1)), DAMAGES[name]
    if damage is None:
        path.unlink()
    else:
        path.write_bytes(damage(path.read_bytes()))
    found = jc.open_campaign(folder)
    assert not found.is_complete and found.finished == 10_000 - 4096
    said = f"1 of 3 chunks in .*kept are missing or do not match .*{path.name}.*computed again"
    with pytest.warns(UserWarning, match=said):
        assert ask(folder).is_complete
    assert [len(own) for own in computed] == [4096]
    assert contents(folder) == contents(whole)


def test_a_chunk_under_the_name_of_another_is_not_that(whole, folder):
    """Where files were renamed, or copied over one another."""
    files = Samples.opened(folder)
    first, second = (files.pieces.path(files.address(i)) for i in (0, 1))
    first.write_bytes(second.read_bytes())
    assert jc.open_campaign(folder).finished == 10_000 - 4096
    with pytest.warns(UserWarning, match=f"1 of 3 chunks.*{first.name}.*computed again"):
        ask(folder)
    assert contents(folder) == contents(whole)


def test_every_flipped_bit_is_seen_or_does_no_harm(folder):
    """At 300 places of a file: its numbers are right, or it counts for nothing."""
    files = Samples.opened(folder)
    path = files.pieces.path(files.address(2))
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
    path = found._samples.pieces.path(found._samples.address(0))
    path.write_bytes(flipped(path.read_bytes(), 0.5))
    with pytest.raises(ValueError, match=f"{path.name} is missing or does not match its checksum"):
        found.summary()


@pytest.mark.parametrize("damage", [lambda text: text[:-9], lambda text: text.replace("1", "2")])
def test_a_damaged_plan_is_written_again(whole, folder, computed, damage):
    (folder / STUDY).write_text(damage((folder / STUDY).read_text()))
    with pytest.raises(ValueError, match=r"study.json does not match its checksum; ask the same"):
        jc.open_campaign(folder)
    with pytest.warns(UserWarning, match="study.json does not match its checksum; it is written"):
        ask(folder)
    assert not computed
    assert contents(folder) == contents(whole)


def test_a_damaged_file_of_a_kept_study_is_computed_again(tmp_path, computed):
    kept = Ledger.opened(tmp_path, "records", {})
    numbers = [np.full(2, float(i)) for i in range(3)]
    for i, own in enumerate(numbers):
        kept.add(own, (np.zeros(3) + i, np.array(i)))
    path = sorted((tmp_path / PIECES).iterdir())[0]
    path.write_bytes(flipped(path.read_bytes(), 0.5))
    kind = (np.zeros(3), np.array(0))
    kept = Ledger.opened(tmp_path, "records", {})
    with pytest.warns(UserWarning, match=f"{path.name} does not match its checksum"):
        found = [kept.taken(own, kind) for own in numbers]
    assert sum(own is None for own in found) == 1
    for i, own in enumerate(found):
        assert own is None or (np.array_equal(own[0], kind[0] + i) and own[1] == i)
    assert kept.taken(numbers[0], np.zeros(4)) is None


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
        with pytest.raises(Unwritable, match=said):
            ask(place)
    assert jc.open_campaign(place).finished == 2 * 4096
    assert ask(place).is_complete
    assert contents(place) == contents(whole)


def test_a_finished_folder_that_is_read_only_answers(folder, monkeypatch, computed):
    before = contents(folder)
    for kind, name in ((Path, "write_bytes"), (Path, "mkdir"), (filelock.FileLock, "acquire")):
        monkeypatch.setattr(kind, name, read_only)
    assert ask(folder).is_complete
    assert jc.open_campaign(folder, problem()).rerun(3)
    assert len(jc.open_campaign(folder).to_dataset()["fit"].to_numpy()) == 10_000
    said = r"\(Read-only file system\). What was finished is kept there; let it be written, ask"
    with pytest.raises(Unwritable, match=said):
        ask(folder, 20_000)
    assert contents(folder) == before and not computed


def test_a_result_that_cannot_be_written_is_said_where_something_is_new(tmp_path):
    result = SimpleNamespace(to_zarr=read_only)
    kept = Ledger.opened(tmp_path, "records", {})
    with pytest.raises(Unwritable, match="Read-only file system"):
        kept.conclude(result)
    (tmp_path / RESULT).mkdir()
    kept.conclude(result)
    kept.add(np.zeros(1), np.zeros(1))
    with pytest.raises(Unwritable, match="Read-only file system"):
        kept.conclude(result)
