"""Lives of many copies of a machine whose numbers vary: `jaxclear.wear_lives`.

One life after the other, each with steps of its own, all by one compiled program.
"""

from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import check_count, check_flags, check_number, expect
from jaxclear.ground.shown import AbstractShown
from jaxclear.ground.table import as_table
from jaxclear.simulation import progress
from jaxclear.simulation.simulate import SimulationError
from jaxclear.studies.datasets import of_rows
from jaxclear.studies.ledger.ledger import Ledger
from jaxclear.studies.life.rates import Rates
from jaxclear.studies.life.result import WearLife
from jaxclear.studies.life.settling import Patience
from jaxclear.studies.life.wear_life import SETTLED, check_asked, lived
from jaxclear.studies.problem import Problem
from jaxclear.studies.sampling import draw
from jaxclear.studies.texts import in_texts


class WearLives(AbstractShown):
    """Lives of a sample. `values` (samples, variables) are the varied numbers, `lives` the life of
    each sample, None for one without a first cycle, `failed` why, by its index; `seed` of the
    sample."""

    problem: Problem
    values: np.ndarray
    lives: tuple[WearLife | None, ...]
    failed: dict[int, str]
    seed: int = eqx.field(static=True)

    @property
    def ended(self) -> dict[int, str]:
        """Why lives ended before their time, by their index; those that failed at once too."""
        early = {i: life.ended for i, life in enumerate(self.lives) if life and life.ended}
        return dict(sorted((self.failed | early).items()))

    @property
    def warned(self) -> tuple[int, ...]:
        """Indices of the lives whose cycles warn."""
        return tuple(i for i, life in enumerate(self.lives) if life and life.warnings)

    def until(self, name: str, limit: float) -> np.ndarray:
        """Cycles (samples,) until a quantity reaches a limit, as `WearLife.until`; `inf` for lives
        that do not reach it, `nan` for those that failed or ended before."""
        found = []
        for life in self.lives:
            cycles = life.until(name, limit).cycles if life else np.nan
            found.append(np.nan if life and life.ended and np.isinf(cycles) else cycles)
        return np.array(found)

    def sentence(self) -> str:
        """How many lives there are, how many ended early and warn, and how far depths are known."""
        known = [life.error for life in self.lives if life]
        worst = f" Depths are known to {100 * max(known):.2g} % or better." if known else ""
        return (
            f"{len(self.lives)} lives, {len(self.ended)} ended early, {len(self.warned)} with "
            f"warnings.{worst}"
        )

    def _shown(self):
        return self.sentence()

    def to_dataset(self) -> Any:
        """The table as an xarray Dataset over the lives, with provenance."""
        return of_rows(
            "wear lives", "life", self.table(), self.problem, result=str(self), seed=self.seed
        )

    def table(self) -> Any:
        """A pandas table, a row a life: variables, cycles reached, the quantities at the end, the
        error of the depth, how it ended, warnings."""
        rows = []
        ended = self.ended
        for i, (values, life) in enumerate(zip(self.values, self.lives, strict=True)):
            row = dict(zip(self.problem.names, map(float, values), strict=True))
            if life is not None:
                row["cycles"] = float(life.cycles[-1])
                for name, unit in life.quantities.items():
                    label = name if unit == "1" else f"{name} [{unit}]"
                    row[label] = life.at_end(name)
                row["error of depth"] = life.error
            warnings = " ".join(life.warnings) if life else ""
            rows.append(row | {"ended": ended.get(i, ""), "warnings": warnings})
        units = dict(zip(self.problem.names, self.problem.variable_units, strict=True))
        return as_table(rows, units=units | {"error of depth": "1"})


@answering
def wear_lives(
    problem: Problem,
    samples: int = 32,
    *,
    cycles: float = 1e6,
    seed: int = 0,
    accuracy: float = 1e-2,
    most: int = 12,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> WearLives:
    """The wear of lives over a quasi-random sample of the problem's variables; `cycles` [1],
    `accuracy` [1], `most` as in `wear_life`, of every one of them. `store`: a folder in which each
    life is kept, from which an interrupted study goes on. A life that has no first cycle keeps its
    row, with a sentence. Raises `ValueError` with a sentence for what cannot be asked.
    """
    expect(problem, Problem, "what lives", "a jaxclear.Problem")
    check_number("cycles of wear_lives", cycles, above=0)
    check_number("accuracy of wear_lives", accuracy, above=0)
    check_count("most of wear_lives", most)
    check_flags("wear_lives", progress_bar=progress_bar)
    check_asked(problem)
    values = draw(problem, samples, seed)
    lives: list[WearLife | None] = []
    failed: dict[int, str] = {}
    with progress.bar(progress_bar, "lives"):
        for i, own in enumerate(values):
            kept = None
            if store is not None:
                texts = in_texts(problem) | {"values of its variables": repr(own.tolist())}
                kept = Ledger.opened(Path(store) / f"{i:06d}", "a wear life", texts)
            try:
                rates = Rates(problem, jnp.asarray(own), Patience(SETTLED, accuracy, most), kept)
                lives.append(lived(rates, float(cycles), float(accuracy), None))
            except (SimulationError, ValueError) as reason:
                lives.append(None)
                failed[i] = str(reason)
            progress.advance(1 / samples)
    return WearLives(problem, values, tuple(lives), failed, seed)
