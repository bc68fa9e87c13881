"""How a campaign's chunks are written to files, and how Dask is asked for them."""

import shutil
from types import SimpleNamespace

import numpy as np
import pytest
import zarr

from jaxclear.studies.campaign.chunk_files import ChunkFiles
from jaxclear.studies.campaign.layout import SAMPLES
from jaxclear.studies.campaign.workers import WORTH, Blocks
from tests.studies.test_campaign import contents, kept_at


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return kept_at(tmp_path_factory.mktemp("campaign") / "kept")


def test_whole_chunks_are_written_as_zarr_writes_them(folder, tmp_path):
    """Byte for byte, arrays of every kind of number that a campaign keeps."""
    shutil.copytree(folder, tmp_path / "kept")
    with zarr.config.set({"array.write_empty_chunks": True}):
        arrays = dict(zarr.open_group(tmp_path / "kept" / SAMPLES, mode="r+").arrays())
    kinds = set()
    for name, array in arrays.items():
        rows = array[:]
        shutil.rmtree(tmp_path / "kept" / SAMPLES / name / "c")
        array[:] = rows
        kinds.add((array.dtype.str, array.ndim))
    assert kinds == {("<f8", 2), ("<f8", 1), ("|i1", 1), ("<i8", 1)}
    assert contents(tmp_path / "kept") == contents(folder)


def test_a_version_of_zarr_may_tell_of_its_codec_by_text(folder, tmp_path):
    """Newer ones have no enumerations: what they tell is the same, and so are the bytes."""
    kept = dict(zarr.open_group(folder / SAMPLES, mode="r").arrays())
    told = {"typesize": 8, "cname": "lz4", "clevel": 1, "shuffle": "shuffle", "blocksize": 0}
    codec = {"name": "blosc", "configuration": told}
    own = SimpleNamespace(**told, to_dict=lambda: codec)
    array = kept["values"]
    assert array.compressors[0].to_dict() == codec
    textual = SimpleNamespace(
        compressors=(own,), dtype=array.dtype, chunks=array.chunks, metadata=array.metadata
    )
    ChunkFiles(tmp_path, {"values": textual}).put("values", 0, array[: array.chunks[0]])
    assert contents(tmp_path) == {
        "values/c/0/0": (folder / SAMPLES / "values" / "c" / "0" / "0").read_bytes()
    }


def test_what_is_no_whole_chunk_is_refused(folder):
    arrays = dict(zarr.open_group(folder / SAMPLES, mode="r").arrays())
    before = contents(folder)
    with pytest.raises(ValueError, match="are no whole chunk of"):
        ChunkFiles(folder / SAMPLES, arrays).put("values", 0, np.zeros((3, 2)))
    assert contents(folder) == before


def asked(chunks, threads, each):
    """Sizes of the blocks that threads are given whose chunks take so long [s] each, and what is
    heard: blocks are answered in their order."""
    blocks, waiting, sizes, told = Blocks(range(chunks), threads), [], [], []
    while blocks.left or waiting:
        while blocks.left and len(waiting) < blocks.most:
            waiting.append(blocks.next())
            sizes.append(len(waiting[-1]))
        block = waiting.pop(0)
        others = blocks.heard(
            block, [0] * len(block), each * len(block), lambda n, _: told.append(n)
        )
        assert not others
    assert sorted(told) == list(range(chunks))
    return sizes


def test_a_task_of_dask_is_as_many_chunks_as_are_worth_it():
    """Nothing is known of the first ones; quick ones come in blocks, fewer toward the end."""
    quick = asked(5000, 2, WORTH / 100)
    assert quick[:4] == [1] * 4
    assert max(quick) == 100
    assert quick[-1] == 1
    assert sum(quick[-4:]) < 10
    assert set(asked(100, 2, 3 * WORTH)) == {1}
    assert max(asked(40, 4, 1e-6)) <= 40 / 4
    assert max(asked(40, 4, 0.0)) <= 40 / 4


def test_chunks_that_others_are_at_are_asked_for_again():
    blocks, told = Blocks(range(2), 1), []
    first = blocks.next()
    assert blocks.heard(first, [None], 0.1, lambda *own: told.append(own))
    assert list(blocks.left) == [1, 0]
    assert not told
