"""What is seen of the joints in the first view: which bodies lie between the eye and a joint with
clearance, and so are drawn as glass.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from jaxclear.results.solids.parts import Part

__all__ = ["hiding"]

# Places of a joint and frames at which is looked; a body hides a joint where it covers more than
# this share of the places. A ray that ends on a surface does not cross it.
PLACES, LOOKS, COVERED, ENDS = 8, 6, 0.25, 1e-3


def hiding(
    parts: Mapping[str, Part],
    moves: Mapping[str, np.ndarray],
    joints: Sequence[tuple[str, str]],
    eye: np.ndarray,
) -> set[str]:
    """Names of the parts whose solid hides one of the `joints` (name, body whose part of it is
    looked at) from the `eye` [m] at some frame; `moves` (frames, 4, 4), of the ground (1, 4, 4),
    bring parts into place."""
    found: set[str] = set()
    frames = max(len(own) for own in moves.values())
    for frame in np.linspace(0, frames - 1, min(LOOKS, frames)).astype(int):
        at = lambda name, points, frame=frame: _moved(points, moves[name][frame % len(moves[name])])
        targets = [_front(at(body, parts[body].joints[name].points), eye) for name, body in joints]
        for name, part in parts.items():
            if name in found or not len(part.solid.points):
                continue
            triangles = at(name, part.solid.points)[part.solid.corners]
            if any(np.mean(_crossed(triangles, eye, own)) > COVERED for own in targets):
                found.add(name)
    return found


def _moved(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def _front(points: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Some of the points (n, 3) on the side of the eye."""
    near = np.argsort(np.linalg.norm(points - eye, axis=1))[: max(len(points) // 2, 1)]
    return points[near[np.linspace(0, len(near) - 1, min(PLACES, len(near))).astype(int)]]


def _crossed(triangles: np.ndarray, eye: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Which rays from the eye to the targets (n, 3) cross a triangle (m, 3, 3) on their way.

    Source: Moller & Trumbore 1997, J. Graphics Tools 2, 21, doi:10.1080/10867651.1997.10487468.
    """
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    from_corner = eye - triangles[:, 0]
    across = np.cross(from_corner, first)
    lengths = np.einsum("ti,ti->t", second, across)
    found = []
    for way in targets - eye:
        beside = np.cross(way, second)
        volume = np.einsum("ti,ti->t", first, beside)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.einsum("ti,ti->t", from_corner, beside) / volume
            v = (across @ way) / volume
            share = lengths / volume
            inside = (u >= 0) & (v >= 0) & (u + v <= 1)
        found.append(np.any(inside & (share > 0) & (share < 1 - ENDS)))
    return np.array(found)
