"""Values of a problem's variables, drawn from their joint distribution.

Quasi-random samples come as independent scramblings of Sobol's sequence: within one, points are
spread evenly, so that means converge faster than those of random samples; between them nothing is
shared, so that their differences tell the error, whatever the response.

Source: Owen 1998, ACM TOMACS 8, 71, doi:10.1145/272991.273010; L'Ecuyer, Nakayama, Owen & Tuffin
2023, Winter Simulation Conference, doi:10.1109/WSC60868.2023.10408613.
"""

import itertools
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground.arguments import check_count, check_known, expect
from jaxclear.ground.precision import check_double_precision
from jaxclear.studies.base import AbstractProblem
from jaxclear.studies.inputs import Inputs
from jaxclear.studies.scrambling import normal_scores, scrambled_shares

__all__ = ["SAMPLINGS", "check_sampled", "draw", "extended", "groups", "usual_scramblings"]

SAMPLINGS = ("sobol", "random")
# More scramblings leave each too few points; fewer leave their differences too few to tell from.
MOST_SCRAMBLINGS = 16
# Samples from which on their values are worth a compiled program, which takes a third of the time;
# its last digits are its own, so that the whole sample decides, not the part that is drawn.
MANY = 1 << 14
# Samples that the program takes at once.
BLOCK = 1 << 12


def usual_scramblings(samples: int) -> int:
    """How many scramblings a sample is made of: a power of two near its root, 16 at the most."""
    return int(min(MOST_SCRAMBLINGS, 2 ** (int(np.log2(samples)) // 2)))


def groups(samples: int, scramblings: int) -> np.ndarray:
    """The scrambling (samples,) that each sample belongs to: one after the other, of equal length
    but for one."""
    return np.arange(samples) * scramblings // samples


def check_sampled(problem: Any, samples: Any, seed: Any, sampling: Any = "sobol") -> None:
    """What is sampled, and how. Raises `ValueError` with a sentence."""
    check_double_precision()
    expect(problem, AbstractProblem, "what is sampled", "a jaxclear.Problem")
    check_known("sampling", sampling, SAMPLINGS)
    check_count("the number of samples", samples)
    check_count("seed", seed, at_least=0)
    if not problem.variables:
        raise ValueError("the problem has no variables; nothing would vary: give it some.")


def draw(
    problem: AbstractProblem,
    samples: int,
    seed: int,
    sampling: str = "sobol",
    scramblings: int = 1,
    span: tuple[int, int] | None = None,
) -> np.ndarray:
    """Values (samples, variables) drawn from the variables' distributions, one scrambling after the
    other as `groups` counts them. `span`: of these only the samples from the first number up to the
    second, the same to the last bit."""
    check_sampled(problem, samples, seed, sampling)
    first, last = (0, samples) if span is None else span
    # Where each scrambling begins.
    starts = [-(-i * samples // scramblings) for i in range(scramblings + 1)]
    parts = [
        (i, max(first - begin, 0), min(last, end) - begin)
        for i, (begin, end) in enumerate(itertools.pairwise(starts))
        if begin < last and end > first
    ]
    return _values(problem, parts, seed, sampling, samples >= MANY)


def extended(
    problem: AbstractProblem, drawn: int, scramblings: int, seed: int, sampling: str
) -> np.ndarray:
    """As many values (scramblings * drawn, variables) again, where every scrambling has `drawn`
    points: its next ones, one scrambling after the other."""
    parts = [(i, drawn, 2 * drawn) for i in range(scramblings)]
    return _values(problem, parts, seed, sampling, False)


def _values(problem, parts, seed, sampling, compiled):
    count = len(problem.names)
    shares = np.concatenate(
        [_shares(count, span, (seed, i), sampling) for i, *span in parts] or [np.zeros((0, count))]
    )
    normal = normal_scores(shares)
    if not compiled:
        return np.asarray(problem.inputs.values(jnp.asarray(normal)))
    # Blocks of one size: a program for another number of rows rounds its last ones otherwise.
    rows = len(normal)
    blocks = np.concatenate([normal, np.zeros((-rows % BLOCK, count))]).reshape(-1, BLOCK, count)
    found = [np.asarray(_of_block(problem.inputs, jnp.asarray(block))) for block in blocks]
    return np.concatenate([*found, np.zeros((0, count))])[:rows]


@eqx.filter_jit
def _of_block(
    inputs: Inputs, normal: Float[Array, "samples variables"]
) -> Float[Array, "samples variables"]:
    """Values of the variables from independent standard normal numbers [1]."""
    return inputs.values(normal)


def _shares(count: int, span: Sequence[int], seed: tuple[int, int], sampling: str) -> np.ndarray:
    """Points of one scrambling, from the first number of a span up to the second; the first of
    all scramblings is that of the plain seed."""
    start, stop = span
    rng = np.random.default_rng(seed if seed[1] else seed[0])
    if stop <= start:
        return np.zeros((0, count))
    if sampling == "random":
        # A number of 53 bits takes one step of the generator.
        generator: Any = rng.bit_generator
        generator.advance(start * count)
        return rng.random((stop - start, count))
    return scrambled_shares(stop, count, rng, start)
