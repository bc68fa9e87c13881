"""Design points: the most likely parts that fail, by FORM.

In standard normal numbers z the likeliest failing part is the one nearest to the middle. The search
steps to the nearest point of the limits as they are linear here, shortened until a merit falls.
Limits that must be broken at once are met together. Where others may lie, the found ones are hidden
under bulges and the search begins anew.

Source: Hasofer & Lind 1974, J. Eng. Mech. Div. 100, 111; Rackwitz & Fiessler 1978, Comput. Struct.
9, 489, doi:10.1016/0045-7949(78)90046-9; Zhang & Der Kiureghian 1995, Reliab. Optim. Struct.
Syst., 297 (merit); Der Kiureghian & Dakessian 1998, Struct. Saf. 20, 37,
doi:10.1016/S0167-4730(97)00026-X (bulges).
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls
from scipy.special import ndtr

from jaxclear.studies.reliability.models import AbstractModel

# A point is found where the limit and the nearest point are this near, in deviations.
NEAR = 1e-3
# Steps of a search, shortenings of a step, and points of one cut set, at the most.
MOST_STEPS, MOST_HALVINGS, MOST_POINTS = 40, 6, 8
# Nothing is looked for further out [deviations]: it would happen once in 1e15 parts.
FURTHEST = 8.0
# Points this far apart are two [deviations].
APART = 0.5
# A further point that is this much rarer than all is not worth another search.
NEGLIGIBLE = 1e-3
# Radius and steepness of a bulge, in shares of beta.
RADIUS, STEEPNESS = 1.1, 0.75
# Where the middle tells no direction, or nothing is found from there, others are tried.
STARTS, START_RADIUS = 6, 2.5


class DesignPoint(NamedTuple):
    """A likeliest failing part: `normal` z (variables,), `beta` its distance from the middle,
    negative where the middle fails; the limits of `cut` that are broken at once, their `directions`
    (limits, variables) outward and `betas` (limits,) as planes through it. `slopes` (limits,) are
    the margins' lengths of slope."""

    normal: np.ndarray
    beta: float
    cut: tuple[int, ...]
    directions: np.ndarray
    betas: np.ndarray
    slopes: np.ndarray

    @property
    def importance(self) -> np.ndarray:
        """Share of each variable in the distance, (variables,) [1]; they add up to one."""
        size = np.linalg.norm(self.normal)
        direction = self.normal / size if size > NEAR else self.directions[0]
        return direction**2


class _Bulge(NamedTuple):
    centre: np.ndarray
    radius: float
    height: float


def design_points(
    model: AbstractModel, cuts: tuple[frozenset[int], ...], variables: int, seed: int
) -> list[DesignPoint]:
    """The design points of each cut set, likeliest first; none where nothing fails within
    `FURTHEST`."""
    rng = np.random.default_rng([seed, 2])
    found: list[DesignPoint] = []
    for cut in cuts:
        found += _of_cut(model, tuple(sorted(cut)), variables, rng)
    single: list[DesignPoint] = []
    for point in sorted(found, key=lambda own: own.beta):
        if all(_new(point, other) or point.cut != other.cut for other in single):
            single.append(point)
    return single


def _of_cut(model, cut, variables, rng) -> list[DesignPoint]:
    found: list[DesignPoint] = []
    bulges: list[_Bulge] = []
    directions = rng.normal(size=(STARTS, variables))
    directions *= START_RADIUS / np.linalg.norm(directions, axis=1, keepdims=True)
    while len(found) < MOST_POINTS:
        point = None
        for start in (np.zeros(variables), *directions):
            point = _search(model, cut, start, bulges)
            # The foot of a bulge is no design point: from there the search goes on without.
            if point is not None and bulges:
                point = _search(model, cut, point.normal, [])
            if point is not None and all(_new(point, other) for other in found):
                break
            point = None
            if found and start is directions[0]:
                break
        if point is None:
            return found
        found.append(point)
        rare = ndtr(-point.beta) < NEGLIGIBLE * sum(ndtr(-own.beta) for own in found)
        if rare or point.beta <= 0.0:
            return found
        height = STEEPNESS * point.beta * point.slopes.max()
        height /= (RADIUS**2 - STEEPNESS**2) ** 2 * point.beta**4
        bulges.append(_Bulge(point.normal, RADIUS * point.beta, height))
    return found


def _new(point: DesignPoint, other: DesignPoint) -> bool:
    return bool(np.linalg.norm(point.normal - other.normal) > APART)


def _search(model, cut, start, bulges) -> DesignPoint | None:
    """The design point that a search from `start` (variables,) ends at; None without one."""
    z = start
    margins, slopes = _seen(model, cut, z, bulges)
    for _ in range(MOST_STEPS):
        sizes = np.linalg.norm(slopes, axis=1)
        if not (np.isfinite(margins).all() and np.isfinite(sizes).all()) or sizes.min() == 0.0:
            return None
        nearest = _nearest(z, margins, slopes)
        if nearest is None:
            return None
        reach = np.linalg.norm(nearest)
        nearest = nearest * min(1.0, FURTHEST / max(reach, FURTHEST))
        broken = margins if len(cut) == 1 else np.maximum(margins, 0.0)
        if np.linalg.norm(nearest - z) < NEAR and np.max(abs(broken) / sizes) < NEAR:
            return _point(z, cut, margins, slopes)
        z, margins, slopes = _stepped(model, cut, bulges, (z, margins, slopes), nearest)
    return None


def _stepped(model, cut, bulges, here, nearest):
    """One step towards `nearest`, shortened until the merit falls; the best one tried if none."""
    z, margins, slopes = here
    sizes = np.linalg.norm(slopes, axis=1)
    broken = lambda own: np.sum((abs(own) if len(cut) == 1 else np.maximum(own, 0.0)) / sizes)
    # Lengths of the penalty: beyond the multiplier, or the merit would not fall along the step.
    penalty = 2.0 * max(np.linalg.norm(z), np.linalg.norm(nearest), 1.0)
    merit = lambda at, own: 0.5 * at @ at + penalty * broken(own)
    before, share, tried = merit(z, margins), 1.0, []
    for _ in range(MOST_HALVINGS):
        at = z + share * (nearest - z)
        seen = _seen(model, cut, at, bulges)
        if np.isfinite(seen[0]).all() and np.isfinite(seen[1]).all():
            value = merit(at, seen[0])
            tried.append((value, at, *seen))
            if value < before - 1e-4 * share * np.sum((nearest - z) ** 2):
                break
        share *= 0.5
    if not tried:
        return here
    return min(tried, key=lambda own: own[0])[1:]


def _seen(model, cut, z, bulges):
    """Margins (limits of the cut,) and slopes (limits, variables), found points hidden."""
    margins, slopes = model.slopes(z[None])
    margins, slopes = margins[0, list(cut)], slopes[0][list(cut)]
    for bulge in bulges:
        away = z - bulge.centre
        left = bulge.radius**2 - away @ away
        if left > 0:
            margins = margins + bulge.height * left**2
            slopes = slopes - 4.0 * bulge.height * left * away
    return margins, slopes


def _nearest(z: np.ndarray, margins: np.ndarray, slopes: np.ndarray) -> np.ndarray | None:
    """The point nearest to the middle where limits that are linear at z are met: one limit on the
    limit, several all broken.

    Several: least distance programming, Lawson & Hanson 1995, doi:10.1137/1.9781611971217.
    """
    if len(margins) == 1:
        own = slopes[0]
        return (own @ z - margins[0]) * own / (own @ own)
    sizes = np.linalg.norm(slopes, axis=1)
    planes = -slopes / sizes[:, None]
    bounds = planes @ z + margins / sizes
    aim = np.zeros(len(z) + 1)
    aim[-1] = 1.0
    system = np.vstack([planes.T, bounds])
    residual = system @ nnls(system, aim)[0] - aim
    return None if abs(residual[-1]) < 1e-12 else -residual[:-1] / residual[-1]


def _point(z, cut, margins, slopes) -> DesignPoint:
    sizes = np.linalg.norm(slopes, axis=1)
    directions = -slopes / sizes[:, None]
    betas = directions @ z + margins / sizes
    beta = float(betas[0]) if len(cut) == 1 else float(np.linalg.norm(z))
    return DesignPoint(z, beta, cut, directions, betas, sizes)
