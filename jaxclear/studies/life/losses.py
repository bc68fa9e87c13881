"""What cycles lose, put on the surfaces of a life: losses of the same cells as one, and depth maps
after so many of them.

Within a cycle no surface changes by what counts, so losses that wear the same cells may be one loss
of their whole volume, in whatever cycle and stage of a step they occur. What this takes for the
same is the finer the more parts losses are put on in, and their number is chosen by what it
changes: the error of both is in that estimate.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxclear.formulations.base import model_of
from jaxclear.multibody.system import System, wear_maps
from jaxclear.native import has_kernels
from jaxclear.native.compiled import AROUND_A_KERNEL, compiled_quickly
from jaxclear.simulation.wear import Losses, Worn, worn_by

# Power by which the parts of a step are shorter towards its end (a graded mesh).
GRADING = 2
# Places that so follow upon each other lie as evenly as they can, however many they are.
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
# Losses are at most this share of all of a contact (1 over it), or as they were: how well a wall
# follows its shape hangs on the number of losses that it takes.
FEWEST = 64
# Losses of a program at the least, in a kernel and elsewhere: fewer compile no program anew. A
# kernel passes by those that fill up.
LEAST_LOSSES = 4096, 128

# Of each loss which cells it wears (`AbstractWearMap.footprint`), by joint and surface.
Footprints = dict[tuple[str, str], Any]
# Of each contact volumes [m3] and location features of its losses, by joint and surface.
Merged = dict[tuple[str, str], list[tuple[np.ndarray, np.ndarray]]]


def footprints(system: System, losses: Losses) -> Footprints:
    """Which cells losses wear.

    Args:
        system: with the wear maps.
        losses: of each surface, with a first axis of time.
    """
    maps = wear_maps(system)
    return {
        (joint, surface): jax.vmap(jax.vmap(maps[joint][surface][0].footprint))(places)
        for (joint, surface), (_, places) in losses.items()
    }


def merge(cycles: Sequence[tuple[float, Losses, Footprints]], resolution: float) -> Merged:
    """Losses of so many of each of some cycles, those of the same cells as one, in the order in
    which they first occur.

    Args:
        cycles: number of them, losses and footprints.
        resolution: part of a cell by which footprints are told apart [cells].
    """
    merged: Merged = {}
    for surface in cycles[0][1]:
        volumes = np.concatenate([n * losses[surface][0] for n, losses, _ in cycles])
        places = np.concatenate([losses[surface][1] for _, losses, _ in cycles])
        cells = [marks[surface] for _, _, marks in cycles]
        keys = None if cells[0] is None else np.round(np.concatenate(cells) / resolution)
        merged[surface] = [
            _merge_alike(volumes[:, k], places[:, k], None if keys is None else keys[:, k])
            for k in range(volumes.shape[1])
        ]
    return merged


def side_by_side(jobs: Sequence[tuple[float, Merged]]) -> tuple[Losses, dict[tuple[str, str], Any]]:
    """(losses of such shares of those of each job, with an axis of jobs in front and one of losses
    that is filled up with zeros; how many there are of each contact).

    Args:
        jobs: share [1] and losses of each.
    """
    counts = {
        surface: np.array([[len(v) for v, _ in merged[surface]] for _, merged in jobs])
        for surface in jobs[0][1]
    }
    most = max(int(count.max()) for count in counts.values())
    least = LEAST_LOSSES[0 if has_kernels() else 1]
    size = max(least, 2 ** (most - 1).bit_length())
    losses: dict[tuple[str, str], Any] = {}
    for surface, count in counts.items():
        features = jobs[0][1][surface][0][1].shape[1]
        volumes = np.zeros((len(jobs), size, count.shape[1]))
        places = np.zeros((*volumes.shape, features))
        for i, (share, merged) in enumerate(jobs):
            for k, (volume, place) in enumerate(merged[surface]):
                volumes[i, : len(volume), k] = share * volume
                places[i, : len(volume), k] = place
        losses[surface] = volumes, places
    return losses, counts


def _merge_alike(
    volumes: np.ndarray, places: np.ndarray, keys: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """(volumes [m3], location features) of the losses of a contact, as one those of equal `keys`
    (None: none are)."""
    some = volumes > 0
    volumes, places = volumes[some], places[some]
    if keys is None or not len(volumes):
        return volumes, places
    _, which, count = np.unique(keys[some], axis=0, return_inverse=True, return_counts=True)
    which = which.ravel()
    shares = np.bincount(which, volumes)[which] / volumes.sum()
    # In how many a place's losses come together, and in which of these each does.
    together = np.ceil(FEWEST * shares)
    rank = np.empty(len(which))
    rank[np.argsort(which, kind="stable")] = np.concatenate([np.arange(n) for n in count])
    pairs = np.stack([which, np.floor(rank * np.minimum(together / count[which], 1.0))], axis=1)
    _, first, which = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    # By the order of their first ones.
    which = np.argsort(np.argsort(first))[which.ravel()]
    sums = np.zeros((len(first), 1 + places.shape[1]))
    np.add.at(sums, which, np.column_stack([volumes, volumes[:, None] * places]))
    return sums[:, 0], sums[:, 1:] / sums[:, :1]


def _wear_in_parts(
    request: Any, worn: Worn, losses: Losses, counts: dict[tuple[str, str], Array], parts: Array
) -> Worn:
    """Depth maps behind the first so many (`counts`) of some losses, put on in so many `parts`,
    the shorter the nearer they are to the end: of the former ones walls forget. In each part the
    losses go by in their order and backwards, from another one on than in the part before, so that
    none comes before the others. All but the first have an axis of jobs in front, which are worn
    side by side."""
    system = model_of(request.mechanism, request.integrator.formulation).system

    def put_on(turn, worn):
        part, backwards = turn // 2, turn % 2 == 1
        begin = part * GOLDEN % 1.0

        def one_job(worn, losses, counts, parts):
            ends = (1.0 - part / parts) ** GRADING, (1.0 - (part + 1) / parts) ** GRADING
            share = jnp.where(part < parts, 0.5 * (ends[0] - ends[1]), 0.0)

            def in_turn(volumes, places, count):
                index = jnp.arange(len(volumes))
                turned = jnp.where(backwards, count - 1 - index, index)
                turned = (turned + jnp.floor(begin * count).astype(int)) % jnp.maximum(count, 1)
                # What fills up stays behind.
                index = jnp.where(index < count, turned, index)
                return share * volumes[index], places[index]

            deposited: Losses = {
                surface: jax.vmap(in_turn, (1, 1, 0), 1)(*parts, counts[surface])
                for surface, parts in losses.items()
            }
            return worn_by(system, worn, deposited)

        return jax.vmap(one_job)(worn, losses, counts, parts)

    return jax.lax.fori_loop(0, 2 * jnp.max(parts), put_on, worn)


wear_in_parts = compiled_quickly(_wear_in_parts, AROUND_A_KERNEL)
