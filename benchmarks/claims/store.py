"""What a study's folder costs by itself: to write a chunk of 1024 samples, with and without its
claim, to read and check it, and to open a campaign of a million samples, every byte of which is
checked. CPU time: the smallest of several, beside SHA-256 of as many bytes alone.
"""

import hashlib
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import jaxclear as jc
from benchmarks.claims.positions import stack
from benchmarks.measure import run_tables, side_by_side
from jaxclear.integrators.checks import Check, Checks
from jaxclear.studies.experiment import SampleResult
from jaxclear.studies.store.batch import pack, unpack
from jaxclear.studies.store.store import CHUNKS, Store

SAMPLES, SOME = 1024, 100
NAMES = ("worn depth", "peak force")


def chunk() -> tuple[np.ndarray, Any]:
    """Values of three variables, two responses and four figures: of a mechanism with two joints
    with clearance, as to its size."""
    random = np.random.default_rng(1)
    drawn = lambda *shape: random.normal(size=(SAMPLES, *shape))
    named = tuple((check, ("A", "B")) for check in [*Check][:2])
    checks: Any = Checks(drawn(4), drawn(4), named)
    outcome: Any = np.zeros(SAMPLES, int)
    ended: Any = np.ones(SAMPLES)
    responses: Any = {name: drawn() for name in NAMES}
    return drawn(3), SampleResult(responses, outcome, ended, checks)


def chunk_rows() -> list[dict[str, Any]]:
    """CPU time of a chunk."""
    values, result = chunk()
    with tempfile.TemporaryDirectory() as place:
        store = Store(Path(place))

        def write() -> None:
            for number in range(SOME):
                store.write(f"{number}", *pack(NAMES, values, result))

        def claim_and_write() -> None:
            for number in range(SOME):
                with store.claim(f"{number}"):
                    store.write(f"{number}", *pack(NAMES, values, result))

        def read() -> None:
            for number in range(SOME):
                found: Any = store.read(f"{number}")
                unpack(NAMES, found.about["figures"], found.arrays)

        write()
        content, files = store.path("0").read_bytes(), [Path(place) / name for name in "ab"]

        def plain() -> None:
            for _ in range(SOME):
                hashlib.sha256(content).digest()
                files[0].write_bytes(content)
                files[0].replace(files[1])

        cases = {
            "written": write,
            "claimed and written": claim_and_write,
            "read": read,
            "hashed, written and renamed by Python alone": plain,
        }
        spent = side_by_side(cases, 15)
        size = len(content)
    return [
        {"a chunk of 1024 samples is": name, "CPU [ms]": 1e3 * spent[name][1] / SOME, "bytes": size}
        for name in cases
    ]


def campaign_rows(samples: int) -> list[dict[str, Any]]:
    """CPU time of a campaign of the stack of ten that is opened."""
    with tempfile.TemporaryDirectory() as place:
        jc.campaign(stack(), samples, folder=place, seed=1)
        files = [*(Path(place) / CHUNKS).iterdir()]
        size = sum(path.stat().st_size for path in files)
        content = bytes(size)
        cases = {
            "opened": lambda: jc.open_campaign(place).finished,
            "opened, and a response read": lambda: (
                jc.open_campaign(place).to_dataset()["response"].to_numpy()
            ),
            "SHA-256 of as many bytes": lambda: hashlib.sha256(content).digest(),
        }
        spent = side_by_side(cases, 5)
    return [
        {"a campaign is": name, "samples": samples, "files": len(files), "CPU [s]": spent[name][1]}
        for name in cases
    ]


TABLES = {
    "A chunk in a store": lambda _: chunk_rows(),
    "A campaign that is opened": lambda options: campaign_rows(
        100_000 if options.quick else 1_000_000
    ),
}

if __name__ == "__main__":
    run_tables(TABLES)
