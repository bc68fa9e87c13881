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

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy

from jaxclear.ground.printing import with_text_repr
from jaxclear.studies.reliability.models import AbstractModel

# A point is found where the limit and the nearest point are this near, in deviations.
NEAR = 2e-3
# Steps of a search, of one among bulges, shortenings of a step, and points of one cut set, at the
# most.
MOST_STEPS, STEPS_HIDDEN, MOST_HALVINGS, MOST_POINTS = 15, 10, 4, 8
# Nothing is looked for further out [deviations]: it would happen once in 1e15 parts.
FURTHEST = 8.0
# Points this far apart are two [deviations].
APART = 0.5
# A further point that is this much rarer than all is not worth another search.
NEGLIGIBLE = 1e-3
# Radius and steepness of a bulge, in shares of beta.
RADIUS, STEEPNESS = 1.1, 0.75
# Slopes of a plane differ by no more than this share of themselves.
FLAT = 1e-6
# Starts of a search, of one among bulges, and how far from the middle they are [deviations].
STARTS, AGAIN, START_RADIUS, OFF_MIDDLE = 6, 3, 2.5, 0.3


@with_text_repr
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

    def __str__(self) -> str:
        return f"a design point {self.beta:.4g} standard deviations from the middle"

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
    model: AbstractModel,
    cuts: tuple[frozenset[int], ...],
    variables: int,
    seed: int,
    hopeless: Callable[[], bool] = lambda: False,
) -> list[DesignPoint]:
    """The design points of each cut set, likeliest first; none where nothing fails within
    `FURTHEST`. `hopeless`: asked where a first search finds none, whether others are in vain."""
    rng = np.random.default_rng([seed, 2])
    found: list[DesignPoint] = []
    for cut in cuts:
        found += _of_cut(model, tuple(sorted(cut)), variables, rng, hopeless)
    single: list[DesignPoint] = []
    for point in sorted(found, key=lambda own: own.beta):
        if all(_new(point, other) or point.cut != other.cut for other in single):
            single.append(point)
    return single


def _of_cut(model, cut, variables, rng, hopeless) -> list[DesignPoint]:
    found: list[DesignPoint] = []
    bulges: list[_Bulge] = []
    directions = rng.normal(size=(STARTS, variables))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    middle = model.margins(np.zeros((1, variables)))[0, list(cut)]
    safe = bool(np.max(middle) > 0) if np.isfinite(middle).all() else True
    # Not from the middle itself, where symmetric limits have no slope or lead to a saddle.
    radii = [OFF_MIDDLE, *[START_RADIUS] * (STARTS - 1)]
    for start in np.asarray(radii)[:, None] * directions:
        first = _found(model, cut, start)
        if first is not None and (first.beta > 0) == safe:
            found.append(first)
            break
        if hopeless():
            return []
    flat = bool(found) and _plane(model, cut, found[0], directions[1])
    while 0 < len(found) < MOST_POINTS and safe and not flat:
        last = found[-1]
        height = STEEPNESS * last.beta * last.slopes.max()
        height /= (RADIUS**2 - STEEPNESS**2) ** 2 * last.beta**4
        bulges.append(_Bulge(last.normal, RADIUS * last.beta, height))
        further = [OFF_MIDDLE * directions[0], -last.normal, *last.beta * directions[1:AGAIN]]
        for start in further:
            where = _search(model, cut, start, bulges, STEPS_HIDDEN)[1]
            # The foot of a bulge is no design point: from there the search goes on without.
            point = _found(model, cut, where)
            if point is not None and point.beta > 0 and all(_new(point, own) for own in found):
                found.append(point)
                break
        else:
            break
        shares = scipy.special.ndtr([-own.beta for own in found])
        if shares[-1] < NEGLIGIBLE * shares.sum():
            break
    return found


def _plane(model, cut, point: DesignPoint, direction: np.ndarray) -> bool:
    """Whether limits have one slope at the point, opposite it and in another direction: planes have
    no other point."""
    own = -point.directions * point.slopes[:, None]
    for at in (-point.normal, START_RADIUS * direction):
        margins, slopes = _seen(model, cut, at, [])
        beside = margins + own @ (point.normal - at)
        flat = np.allclose(slopes, own, rtol=0, atol=FLAT * point.slopes.max())
        if not flat or not np.all(abs(beside) < NEAR * point.slopes):
            return False
    return True


def _new(point: DesignPoint, other: DesignPoint) -> bool:
    return bool(np.linalg.norm(point.normal - other.normal) > APART)


def _found(model, cut, start) -> DesignPoint | None:
    """The design point that a search from `start` (variables,) leads to. Where a limit bends as
    much as the distance, steps to planes go to and fro, and a method that learns curvatures goes
    on.

    That method: SLSQP of scipy, Kraft 1988, DFVLR-FB 88-28.
    """
    point, where = _search(model, cut, start, [], MOST_STEPS)
    if point is not None or not np.isfinite(where).all():
        return point
    seen: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def limits(z):
        if z.tobytes() not in seen:
            margins, slopes = _seen(model, cut, z, [])
            size = np.maximum(sizes, np.finfo(float).tiny)
            seen[z.tobytes()] = -margins / size, -slopes / size[:, None]
        return seen[z.tobytes()]

    sizes = np.linalg.norm(_seen(model, cut, where, [])[1], axis=1)
    if not np.isfinite(sizes).all() or sizes.min() == 0.0:
        return None
    found = scipy.optimize.minimize(
        lambda z: (0.5 * z @ z, z),
        where,
        jac=True,
        method="SLSQP",
        constraints={
            "type": "eq" if len(cut) == 1 else "ineq",
            "fun": lambda z: limits(z)[0],
            "jac": lambda z: limits(z)[1],
        },
        options={"maxiter": MOST_STEPS, "ftol": NEAR**2},
    )
    return _search(model, cut, found.x, [], 1)[0] if np.isfinite(found.x).all() else None


def _search(model, cut, start, bulges, steps) -> tuple[DesignPoint | None, np.ndarray]:
    """The design point that a search from `start` (variables,) ends at, None without one; and where
    it has come to."""
    z = start
    margins, slopes = _seen(model, cut, z, bulges)
    for _ in range(steps):
        sizes = np.linalg.norm(slopes, axis=1)
        if not (np.isfinite(margins).all() and np.isfinite(sizes).all()) or sizes.min() == 0.0:
            return None, z
        nearest = _nearest(z, margins, slopes)
        if nearest is None:
            return None, z
        nearest = nearest * min(1.0, FURTHEST / max(float(np.linalg.norm(nearest)), FURTHEST))
        broken = margins if len(cut) == 1 else np.maximum(margins, 0.0)
        if np.linalg.norm(nearest - z) < NEAR and np.max(abs(broken) / sizes) < NEAR:
            return _point(z, cut, margins, slopes), z
        z, margins, slopes = _stepped(model, cut, bulges, (z, margins, slopes), nearest)
    return None, z


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
    residual = system @ scipy.optimize.nnls(system, aim)[0] - aim
    return None if abs(residual[-1]) < 1e-12 else -residual[:-1] / residual[-1]


def _point(z, cut, margins, slopes) -> DesignPoint:
    sizes = np.linalg.norm(slopes, axis=1)
    directions = -slopes / sizes[:, None]
    betas = directions @ z + margins / sizes
    beta = float(betas[0]) if len(cut) == 1 else float(np.linalg.norm(z))
    return DesignPoint(z, beta, cut, directions, betas, sizes)
