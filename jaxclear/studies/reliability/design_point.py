"""Design points: the most likely parts that fail, by FORM.

In standard normal numbers z the likeliest failing part is the one nearest to the middle: the least
of z^2 / 2 with the limit reached, or with several broken at once, by sequential quadratic
programming (SLSQP of scipy). Where others may lie, the found ones are hidden under bulges and the
search begins anew.

Source: Hasofer & Lind 1974, J. Eng. Mech. Div. 100, 111; Liu & Der Kiureghian 1991, Struct. Saf. 9,
161, doi:10.1016/0167-4730(91)90041-7 (search by optimisation); Kraft 1988, DFVLR-FB 88-28 (SLSQP);
Der Kiureghian & Dakessian 1998, Struct. Saf. 20, 37, doi:10.1016/S0167-4730(97)00026-X (bulges).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy

from jaxclear.ground.printing import with_text_repr
from jaxclear.studies.reliability.models import AbstractModel

# A point is found where the limit and the nearest point are this near, in deviations.
NEAR = 2e-3
# and where the slope points along it but for this [1].
ALONG = 2e-2
# Places that a search looks at, and one among bulges, and points of one cut set, at the most.
MOST_STEPS, STEPS_HIDDEN, MOST_POINTS = 40, 20, 8
# Steps to planes with which a search begins.
FIRST_STEPS = 3
# Nothing is looked for further out [deviations]: it would happen once in 1e15 parts.
FURTHEST = 8.0
# Points this far apart are two [deviations].
LEAST_DISTANCE = 0.5
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
    """The design points of each cut set, likeliest first; none without a failure in `FURTHEST`.

    Args:
        model: margins at standard normal numbers.
        cuts: sets of limits that fail together.
        variables: number of variables.
        seed: of the searches' starts.
        hopeless: function called where a first search finds none: whether others are in vain.
    """
    rng = np.random.default_rng([seed, 2])
    points: list[DesignPoint] = []
    for cut in cuts:
        points += _points_of_cut(model, tuple(sorted(cut)), variables, rng, hopeless)
    single: list[DesignPoint] = []
    for point in sorted(points, key=lambda candidate: candidate.beta):
        if all(_new(point, other) or point.cut != other.cut for other in single):
            single.append(point)
    return single


def _points_of_cut(model, cut, variables, rng, hopeless) -> list[DesignPoint]:
    points: list[DesignPoint] = []
    bulges: list[_Bulge] = []
    directions = rng.normal(size=(STARTS, variables))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    middle = model.margins(np.zeros((1, variables)))[0, list(cut)]
    safe = bool(np.max(middle) > 0) if np.isfinite(middle).all() else True
    # Not from the middle itself, where symmetric limits have no slope or lead to a saddle.
    radii = [OFF_MIDDLE, *[START_RADIUS] * (STARTS - 1)]
    for start in np.asarray(radii)[:, None] * directions:
        first = _find_point(model, cut, start)
        if first is not None and (first.beta > 0) == safe:
            points.append(first)
            break
        if hopeless():
            return []
    flat = bool(points) and _is_plane(model, cut, points[0], directions[1])
    while 0 < len(points) < MOST_POINTS and safe and not flat:
        last = points[-1]
        height = STEEPNESS * last.beta * last.slopes.max()
        height /= (RADIUS**2 - STEEPNESS**2) ** 2 * last.beta**4
        bulges.append(_Bulge(last.normal, RADIUS * last.beta, height))
        further = [OFF_MIDDLE * directions[0], -last.normal, *last.beta * directions[1:AGAIN]]
        for start in further:
            where = _search_point(model, cut, start, bulges, STEPS_HIDDEN)
            # The foot of a bulge is no design point: from there the search goes on without.
            point = None if where is None else _find_point(model, cut, where)
            if point is not None and point.beta > 0 and all(_new(point, other) for other in points):
                points.append(point)
                break
        else:
            break
        shares = scipy.special.ndtr([-other.beta for other in points])
        if shares[-1] < NEGLIGIBLE * shares.sum():
            break
    return points


def _is_plane(model, cut, point: DesignPoint, direction: np.ndarray) -> bool:
    """Whether limits have one slope at the point, opposite it and in another direction: planes have
    no other point."""
    gradients = -point.directions * point.slopes[:, None]
    for at in (-point.normal, START_RADIUS * direction):
        margins, slopes = _evaluate_margins(model, cut, at, [])
        margins_at_point = margins + gradients @ (point.normal - at)
        flat = np.allclose(slopes, gradients, rtol=0, atol=FLAT * point.slopes.max())
        if not flat or not np.all(abs(margins_at_point) < NEAR * point.slopes):
            return False
    return True


def _new(point: DesignPoint, other: DesignPoint) -> bool:
    return bool(np.linalg.norm(point.normal - other.normal) > LEAST_DISTANCE)


def _find_point(model, cut, start) -> DesignPoint | None:
    """The design point that a search from `start` (variables,) leads to."""
    z = _search_point(model, cut, start, [], MOST_STEPS)
    if z is None or not np.linalg.norm(z) <= FURTHEST:
        return None
    margins, slopes = _evaluate_margins(model, cut, z, [])
    sizes = np.linalg.norm(slopes, axis=1)
    if not np.isfinite(margins).all() or not np.isfinite(sizes).all() or sizes.min() == 0.0:
        return None
    directions = -slopes / sizes[:, None]
    betas = directions @ z + margins / sizes
    single = len(cut) == 1
    broken = np.abs(margins) if single else np.maximum(margins, 0.0)
    # The nearest to the middle of a limit that is a plane lies along its slope.
    aside = float(np.linalg.norm(betas[0] * directions[0] - z)) if single else 0.0
    if np.max(broken / sizes) > NEAR or aside > ALONG * max(float(np.linalg.norm(z)), 1.0):
        return None
    beta = float(betas[0]) if single else float(np.linalg.norm(z))
    return DesignPoint(z, beta, cut, directions, betas, sizes)


def _search_point(model, cut, start, bulges, steps) -> np.ndarray | None:
    """The place (variables,) to which a search from `start` leads that looks at so many; None where
    limits have no slopes at its start, or are no numbers."""
    cache: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def limits(z):
        if z.tobytes() not in cache:
            if len(cache) == steps:
                raise StopIteration
            cache[z.tobytes()] = _evaluate_margins(model, cut, z, bulges)
        return cache[z.tobytes()]

    # Far from the limit slopes may be next to none: there it is taken for a plane.
    for _ in range(FIRST_STEPS if len(cut) == 1 and not bulges else 0):
        (margin,), (slope,) = limits(start)
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            nearest = (slope @ start - margin) * slope / (slope @ slope)
            nearest = nearest * min(1.0, FURTHEST / float(np.linalg.norm(nearest)))
        if not np.isfinite(nearest).all():
            break
        if np.linalg.norm(nearest - start) < NEAR:
            return start
        start = nearest
    sizes = np.linalg.norm(limits(start)[1], axis=1)
    if not np.isfinite(sizes).all() or sizes.min() == 0.0:
        return None
    try:
        result = scipy.optimize.minimize(
            lambda z: (0.5 * z @ z, z),
            start,
            jac=True,
            method="SLSQP",
            bounds=[(-FURTHEST, FURTHEST)] * len(start),
            constraints={
                "type": "eq" if len(cut) == 1 else "ineq",
                "fun": lambda z: -limits(z)[0] / sizes,
                "jac": lambda z: -limits(z)[1] / sizes[:, None],
            },
            options={"ftol": NEAR**2},
        ).x
    except StopIteration:
        result = np.frombuffer([*cache][-1])
    return result if np.isfinite(result).all() else None


def _evaluate_margins(model, cut, z, bulges):
    """Margins (limits of the cut,) and slopes (limits, variables), found points hidden."""
    margins, slopes = model.slopes(z[None])
    margins, slopes = margins[0, list(cut)], slopes[0][list(cut)]
    for bulge in bulges:
        away = z - bulge.centre
        height = bulge.radius**2 - away @ away
        if height > 0:
            margins = margins + bulge.height * height**2
            slopes = slopes - 4.0 * bulge.height * height * away
    return margins, slopes
