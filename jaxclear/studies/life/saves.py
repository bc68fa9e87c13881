"""By how much what a cycle wears hangs on its saving times.

Surfaces are updated at saving times: what is lost in between is spread over the arc that the
contact went through. Where force or place change fast, within an impact, that is not how it was
lost. Every cycle tells what it would have worn with every fourth of its saving times.
"""

from typing import NamedTuple

import numpy as np
from jax.flatten_util import ravel_pytree

from jaxclear.studies.life.nodes import Cells, Node
from jaxclear.studies.life.settling import Settling


class Stage(NamedTuple):
    """A point of a life at which cycles were run: the `node` of the steps, and how the motion
    `settled` there."""

    node: Node
    settled: Settling


def share_by_saves(stage: Stage, cells: Cells, surfaces: int) -> float:
    """By which share the depth that a cycle wears would be another one, of the worst of the first
    `surfaces`."""
    rate = stage.node.rate.wear
    other = np.zeros_like(rate)
    flat = ravel_pytree(stage.settled.by_saves)[0]
    other[: len(flat)] = flat
    return float(cells.shares(other, rate)[:surfaces].max(initial=0.0))
