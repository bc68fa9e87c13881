"""Whether a mechanism is assembled the way that its guess means: the search for closed loops may
step across a position in which an elbow is straight, from a guess that is near to it or far from
closed. Other guesses are then tried, and a way to assemble that lies nearer is told.
"""

import warnings
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.parts import Parts
from jaxclear.multibody.start_equations import Start
from jaxclear.multibody.topology import Branch

# A guess that is met so well was not missed [rad, m].
MET = 0.05
# Guesses that are tried, on the line from the guess (0) to where it has led (1).
TRIED = (-1.0, -0.5, 0.25, 0.5)
# A way to assemble is nearer if its distance is this share of the other's.
NEARER = 0.8


def warn_of_nearer_assembly(
    mechanism: Mechanism, start: Start, assembled: Callable[[Mechanism], tuple]
) -> None:
    """Warns where `start`, of a mechanism with numbers, is not the way to assemble that lies
    nearest to what is guessed; `assembled`: start, and whether it is sound, of other guesses."""
    branches = _guessed(mechanism)
    if not branches or not start.residuals:
        return
    rough = np.array([float(mechanism.guess[branch.name][0]) for branch in branches])
    missed = _apart(mechanism, branches, start, rough)
    if np.max(np.abs(missed)) <= MET:
        return
    for share in TRIED:
        tried = zip(branches, rough + share * missed, strict=True)
        guess = Parts(mechanism.guess | {branch.name: (jnp.asarray(x),) for branch, x in tried})
        other, sound = assembled(eqx.tree_at(lambda m: m.guess, mechanism, guess))
        found = _apart(mechanism, branches, other, rough)
        if sound and np.linalg.norm(found) < NEARER * np.linalg.norm(missed):
            warnings.warn(
                f"guess={{{_told(branches, rough)}}} has led to {_told(branches, rough + missed)}, "
                "although the mechanism can also be assembled nearer to it, with "
                f"{_told(branches, rough + found)}. If that is meant, guess it so.",
                stacklevel=2,
            )
            return


def _guessed(mechanism: Mechanism) -> list[Branch]:
    """Branches of the tree whose single coordinate is guessed."""
    return [
        branch
        for branch in mechanism.topology.branches
        if branch.name in mechanism.guess and branch.coordinate_count == 1
    ]


def _apart(
    mechanism: Mechanism, branches: list[Branch], start: Start, rough: np.ndarray
) -> np.ndarray:
    """From what is guessed to a start [rad, m], angles by the shorter way."""
    places = np.asarray(start.coordinates)[[branch.coordinates.start for branch in branches]]
    apart = places - rough
    turns = [mechanism.connections[b.name].joint.units == ("rad",) for b in branches]
    return np.where(turns, np.angle(np.exp(1j * apart)), apart)


def _told(branches: list[Branch], values: np.ndarray) -> str:
    return ", ".join(f'"{b.name}": {x:.6g}' for b, x in zip(branches, values, strict=True))
