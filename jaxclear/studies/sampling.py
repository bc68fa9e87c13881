"""Values of a problem's variables, drawn from their joint distribution.

A sample's values hang on its number, and not on how many there are: a larger study begins with the
samples of a smaller one of as many scramblings, as all have by default from 64 samples on.

Quasi-random samples come as independent scramblings of Sobol's sequence: within one, points are
spread evenly, so that means converge faster than those of random samples; between them nothing is
shared, so that their differences tell the error, whatever the response.

Source: Owen 1998, ACM TOMACS 8, 71, doi:10.1145/272991.273010; L'Ecuyer, Nakayama, Owen & Tuffin
2023, Winter Simulation Conference, doi:10.1109/WSC60868.2023.10408613.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.ground.arguments import check_count, check_name, expect
from jaxclear.ground.precision import check_double_precision
from jaxclear.studies.inputs import Inputs
from jaxclear.studies.problem import Problem
from jaxclear.studies.scrambling import ScrambledSequence, normal_scores

SAMPLINGS = ("sobol", "random")
# Points that are spread evenly gain with their number, so few scramblings are exact; differences of
# few tell an error less well. 8 is the least power of two whose Student's factor, 2.36, is within a
# quarter of that of many, 1.96: that much an interval widens where points gain nothing.
MOST_SCRAMBLINGS = 8
# Samples whose values are computed at once, by the same operations wherever a sample is drawn:
# with another number of rows the last ones may be rounded otherwise.
BLOCK = 1 << 12


def usual_scramblings(samples: int) -> int:
    """How many scramblings a sample is made of: a power of two near its root, 8 at the most."""
    return int(min(MOST_SCRAMBLINGS, 2 ** (int(np.log2(samples)) // 2)))


def groups(samples: int, scramblings: int, first: int = 0) -> np.ndarray:
    """Scrambling to which each sample belongs, shape (samples - first,): they take turns.

    Args:
        samples: number of samples.
        scramblings: number of scramblings.
        first: number of the first sample in the result.
    """
    return np.arange(first, samples) % scramblings


def by_scrambling(rows: np.ndarray, scramblings: int) -> np.ndarray:
    """Rows (samples, columns) in which the scramblings take turns, each as often as the others, as
    (scramblings, points, columns)."""
    return rows.reshape(-1, scramblings, rows.shape[1]).swapaxes(0, 1)


def check_sampled(problem: Any, samples: Any, seed: Any, sampling: Any = "sobol") -> None:
    """Raises `ValueError` for what cannot be sampled, or not in this way.

    Args:
        problem: with variables and responses.
        samples: their number.
        seed: whole number.
        sampling: name of the sequence.
    """
    check_double_precision()
    expect(problem, Problem, "what is sampled", "a jaxclear.Problem")
    check_name("sampling", sampling, SAMPLINGS)
    check_count("the number of samples", samples)
    check_count("seed", seed, at_least=0)
    if not problem.response_names:
        raise ValueError(
            "the problem answers no number, only series; give it one, such as a mean or the "
            "largest (series are compared with measurements, by jaxclear.identify)."
        )
    if not problem.variables:
        raise ValueError("the problem has no variables; nothing would vary: give it some.")


def checked_scramblings(owner: str, samples: int, count: Any) -> int:
    """The number of scramblings.

    Args:
        owner: function in the message.
        samples: number of samples.
        count: as given; None: the usual number.

    Raises:
        ValueError: it is no whole number, or above that of the samples.
    """
    parts = usual_scramblings(samples) if count is None else count
    check_count(f"scramblings of {owner}", parts)
    if parts > samples:
        raise ValueError(f"{samples} samples cannot be {parts} scramblings; take fewer of these.")
    return parts


def draw(
    problem: Problem,
    samples: int,
    seed: int,
    sampling: str = "sobol",
    scramblings: int = 1,
    span: tuple[int, int] | None = None,
) -> np.ndarray:
    """Values (samples, variables) drawn from the variables' joint distribution.

    Args:
        problem: with the variables.
        samples: their number.
        seed: of the scramblings.
        sampling: name of the sequence.
        scramblings: number of independent ones, which take turns (`groups`).
        span: first and last sample of a part, which is the same to the last bit; None: all.
    """
    check_sampled(problem, samples, seed, sampling)
    drawing = Drawing(problem, seed, sampling, scramblings)
    return drawing.span(*((0, samples) if span is None else span))


class Drawing:
    """A sample that is drawn piece by piece, in any order."""

    def __init__(self, problem: Problem, seed: int, sampling: str, scramblings: int):
        self.inputs, self.count = problem.inputs, len(problem.names)
        # The first of all scramblings is that of the plain seed.
        self.seeds: list[Any] = [(seed, i) if i else seed for i in range(scramblings)]
        rngs = [np.random.default_rng(s) for s in self.seeds]
        self.sequences: list[Any] = []
        if sampling == "sobol":
            self.sequences = [ScrambledSequence(self.count, rng) for rng in rngs]

    def span(self, first: int, last: int) -> np.ndarray:
        """Values (last - first, variables) of the samples from the first number up to the last."""
        parts = len(self.seeds)
        shares = np.zeros((last - first, self.count))
        for i in range(parts):
            # The points of this scrambling that are among them.
            begin, end = -((i - first) // parts), -((i - last) // parts)
            if end > begin:
                shares[begin * parts + i - first :: parts] = self._shares(i, begin, end)
        return _values_of_normal(self.inputs, normal_scores(shares), first)

    def _shares(self, scrambling: int, first: int, last: int) -> np.ndarray:
        """Points of one scrambling, from the first number up to the last."""
        if self.sequences:
            return self.sequences[scrambling].points(first, last)
        rng = np.random.default_rng(self.seeds[scrambling])
        # A number of 53 bits takes one step of the generator.
        generator: Any = rng.bit_generator
        generator.advance(first * self.count)
        return rng.random((last - first, self.count))


def _values_of_normal(inputs: Inputs, normal: np.ndarray, first: int) -> np.ndarray:
    """Values of the samples from number `first` on, from independent standard normal numbers [1].
    Each is computed at the same place of the same block, whatever is drawn with it."""
    rows, count = normal.shape
    before = first % BLOCK
    padded = np.zeros((before + rows + -(before + rows) % BLOCK, count))
    padded[before : before + rows] = normal
    blocks = [np.asarray(inputs.values(block)) for block in padded.reshape(-1, BLOCK, count)]
    return np.concatenate([padded[:0], *blocks])[before : before + rows]


def all_values(problem: Problem, normal: np.ndarray) -> np.ndarray:
    """Values (samples, variables) that standard normal numbers (samples, variables) stand for."""
    return np.array(problem.inputs.values(normal))


@eqx.filter_jit
def _slopes_of_each(problem, normal):
    return jax.vmap(jax.jacfwd(problem.inputs.values))(normal)


def value_slopes(problem: Problem, normal: np.ndarray) -> np.ndarray:
    """How the values move with the standard normal numbers, (samples, variables, variables)."""
    return np.asarray(_slopes_of_each(problem, jnp.asarray(normal)))
