"""What a study asks of its problem, kept: each set of samples by itself, piece by piece.

A study asked the same again asks the same in the same order, and is answered from the folder up to
where it was interrupted.
"""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.studies.base import AbstractProblem
from jaxclear.studies.batch import KEEPER, chunk_size, evaluate_all, threads_of
from jaxclear.studies.store import Store
from jaxclear.studies.texts import in_texts

__all__ = ["kept_requests"]

NAME = "{}-{:04d}"


class _Requests:
    """The sets of samples that a study asks for, one folder each, in their order; those of each
    kind are counted by themselves."""

    def __init__(self, folder: Path, what: str):
        self.folder, self.what = folder, what
        self.count: Counter[str] = Counter()

    def answered(
        self,
        problem: AbstractProblem,
        values: Any,
        *,
        chunk: int | None,
        function: Any,
        kept_as: str,
        **shown: Any,
    ) -> Any:
        """What `evaluate_all` gives for values (samples, variables), from the folder as far as it
        is there."""
        place = self.folder / NAME.format(kept_as, self.count[kept_as])
        store = Store.opened(place, self.what, in_texts(problem))
        self.count[kept_as] += 1
        values = np.asarray(values)
        # Pieces of whole chunks: samples are computed as without a folder.
        chunk = chunk_size(problem, len(values), chunk)
        size = chunk * min(threads_of(), -(-len(values) // chunk))
        padded = np.concatenate([values, np.repeat(values[-1:], -len(values) % size, axis=0)])
        pieces = padded.reshape(-1, size, values.shape[1])
        kind = eqx.filter_eval_shape(function, problem, jnp.asarray(pieces[0]))
        found = []
        for piece in pieces:
            known = store.taken(piece.ravel(), kind)
            if known is None:
                with _not_kept():
                    asked = jnp.asarray(piece)
                    known = evaluate_all(problem, asked, chunk=chunk, function=function, **shown)
                store.add(piece.ravel(), known)
            found.append(known)
        return jax.tree.map(lambda *parts: np.concatenate(parts)[: len(values)], *found)


@contextmanager
def kept_requests(folder: Path, what: str) -> Iterator[None]:
    """All samples that a study computes within are kept in a folder. `what`: the study, in
    words."""
    token = KEEPER.set(_Requests(folder, what).answered)
    try:
        yield
    finally:
        KEEPER.reset(token)


@contextmanager
def _not_kept() -> Iterator[None]:
    token = KEEPER.set(None)
    try:
        yield
    finally:
        KEEPER.reset(token)
