"""Which texts of a figure lie upon each other or leave it: a reader sees it at once, a number does
not.

The figure is drawn as `savefig` draws it, by a renderer that notes every line of text where its ink
is, turned as it is turned.
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.figure import Figure

__all__ = ["colliding"]

# Ink may come so near [pixel] to other ink, or to the edge, by the rounding of glyphs.
ROUNDING = 1.0


class Line(NamedTuple):
    """A line of text, and the `corners` (4, 2) of its ink [pixel], one after the other."""

    text: str
    corners: np.ndarray


class Noting(RendererAgg):
    """Draws all but text, and notes the `lines` of that."""

    def __init__(self, *args):
        super().__init__(*args)
        self.lines: list[Line] = []

    def draw_text(self, gc, x, y, s, prop, angle, ismath=False, mtext=None):
        """Notes a line that begins in (x, y) [pixel, downwards], turned by `angle` [deg]."""
        width, height, below = self.get_text_width_height_descent(s, prop, ismath)
        turn = np.radians(angle)
        along = np.array([np.cos(turn), np.sin(turn)])
        up = np.array([-along[1], along[0]])
        start = np.array([x, self.height - y]) - below * up
        ends = [start, start + width * along, start + width * along + height * up]
        if s.strip():
            self.lines.append(Line(s, np.array([*ends, start + height * up])))


def colliding(figure: Figure) -> list[str]:
    """A sentence for each pair of texts of a figure that lie upon each other, and for each one that
    leaves it; none where all can be read."""
    figure.draw_without_rendering()
    width, height = figure.get_size_inches() * figure.dpi
    renderer = Noting(int(width), int(height), figure.dpi)
    figure.draw(renderer)
    lines, ends = renderer.lines, np.array([width, height])
    found = [
        f'"{one.text}" and "{other.text}" lie upon each other.'
        for one, other in combinations(lines, 2)
        if _overlap(one.corners, other.corners)
    ]
    return found + [
        f'"{line.text}" leaves the figure.'
        for line in lines
        if line.corners.min() < -ROUNDING or np.any(line.corners > ends + ROUNDING)
    ]


def _overlap(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two rectangles have more in common than rounding: no side of either parts them."""
    for corners in (one, other):
        for side in corners[1:3] - corners[:2]:
            normal = side / (np.linalg.norm(side) or 1.0)
            own, others = one @ normal, other @ normal
            if min(own.max(), others.max()) - max(own.min(), others.min()) < ROUNDING:
                return False
    return True
