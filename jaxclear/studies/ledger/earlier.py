"""Folders that versions 0.29 to 0.32 wrote, read once more: to go in the version after 0.33.

A campaign was a Zarr group of arrays with a mark for each finished chunk; of other studies there
were rows of numbers, what was asked and what was answered, in the order in which they asked. What
is taken from there is kept anew, so such a folder is one of today once its study is asked again.
"""

import json
from functools import cached_property
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxclear.integrators.checks import Check, Checks, Figure
from jaxclear.studies.base import SampleResult
from jaxclear.studies.ledger.pieces import Piece
from jaxclear.studies.texts import first_difference

# Names of the Zarr groups and arrays.
SAMPLES, RECORDS, NUMBERS = "samples.zarr", "records.zarr", "numbers"
COLUMNS = {"check_worst": "worst", "check_time": "when"}
# In which order samples of campaigns came since 0.29.
ORDER = "scramblings by turns"


class EarlierSamples:
    """The finished chunks of a campaign."""

    def __init__(self, folder: Path):
        import zarr

        self.folder = folder
        group: Any = zarr.open_group(folder / SAMPLES, mode="r")
        self.arrays: dict[str, Any] = dict(group.arrays())
        self.told: dict[str, Any] = dict(group.attrs)
        if self.told.pop("order", None) != ORDER:
            raise ValueError(
                f"the folder {folder} is of an earlier version of jaxclear, whose samples came in "
                "another order; go on with that version, or give another folder."
            )
        self.figures = self.told.pop("figures")

    @staticmethod
    def are_in(folder: Path) -> bool:
        """Whether a folder holds such a campaign."""
        return (folder / SAMPLES / "zarr.json").exists()

    def read(self, number: int, first: int, last: int) -> Piece | None:
        """A chunk, its first sample and the one after its last; None of one that is not
        finished."""
        marks = self.arrays["finished"]
        if number >= marks.shape[0] or not marks[number]:
            return None
        last = min(last, self.told["plan"]["samples"])
        arrays: dict[str, Any] = {
            COLUMNS.get(name, name): array[first:last]
            for name, array in self.arrays.items()
            if name != "finished"
        }
        signed = self.folder / "versions" / f"{int(marks[number]):x}.json"
        versions = json.loads(signed.read_text())
        about = {"samples": last - first, "figures": self.figures, "versions": versions}
        return Piece(about, arrays)

    def finer(self) -> SampleResult | None:
        """What the first samples gave in finer runs."""
        path = self.folder / "replicas.json"
        if not path.exists():
            return None
        kept = json.loads(path.read_text())
        by_name: Any = {name: np.array(own, float) for name, own in kept["responses"].items()}
        outcome: Any = np.array(kept["outcome"], int)
        ended: Any = np.array(kept["ended"], float)
        return SampleResult(by_name, outcome, ended)


def second_look(told: dict[str, Any]) -> tuple[str, ...]:
    """What a version up to 0.29 found to be off in a second look at the nominal sample."""
    figures = {
        Check[name]: Figure(jnp.asarray(worst), jnp.asarray(when), tuple(places))
        for name, worst, when, places in told.get("second_look", ())
    }
    return Checks.of(figures).warnings


class EarlierRecords:
    """What was asked and answered in a folder and in those within, a row for each."""

    def __init__(self, folder: Path):
        self.places = sorted([*folder.glob(RECORDS), *folder.glob(f"*-[0-9]*/{RECORDS}")])

    @cached_property
    def groups(self) -> list[tuple[dict[str, Any], np.ndarray]]:
        """What each tells of itself, and its rows (1, asked, answered) that were written whole."""
        import zarr

        found = []
        for place in self.places:
            group: Any = zarr.open_group(place, mode="r")
            rows = group[NUMBERS][:]
            found.append((dict(group.attrs), rows[rows[:, 0] == 1.0]))
        return found

    @property
    def told(self) -> dict[str, Any]:
        """What the folder tells of its study."""
        return self.groups[0][0]

    def taken(
        self, texts: dict[str, str], asked: np.ndarray, leaves: list[Any], beside: Any
    ) -> list[np.ndarray] | None:
        """The arrays that answered; None where these numbers were not asked of a problem with
        these texts. `leaves` have their shapes; `beside`: all that is asked with them, for rows
        held several answers."""
        sizes = [int(np.prod(leaf.shape)) for leaf in leaves]
        asked, width = np.ravel(asked), asked.size + sum(sizes)
        every = asked[None] if beside is None else np.reshape(beside, (-1, asked.size))
        for told, rows in self.groups:
            many, rest = divmod(rows.shape[1] - 1, width)
            if rest or not many or first_difference(json.loads(told["problem"]), texts):
                continue
            for row in rows[:, 1:]:
                parts = row[: many * asked.size].reshape(many, -1)
                own = np.flatnonzero((parts == asked).all(axis=1))
                if len(own) and all((every == part).all(axis=1).any() for part in parts):
                    ends = np.cumsum([many * size for size in sizes])[:-1]
                    answered = np.split(row[many * asked.size :], ends)
                    return [
                        whole.reshape(many, -1)[own[0]].reshape(leaf.shape).astype(leaf.dtype)
                        for whole, leaf in zip(answered, leaves, strict=True)
                    ]
        return None
