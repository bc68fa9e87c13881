"""What holds journals along their axis: collars; in bearings that always touch the model, where
there are none; else nothing.

What collars carry that always touch is the reaction along the axis, which is not among their
contact forces, rubs nothing and wears nothing.
"""

from collections.abc import Iterable

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.formulations.base import ContactReport
from jaxclear.formulations.model import Instant, Model
from jaxclear.formulations.permanent_reactions import touching
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.system import System
from jaxclear.simulation.gap_motion import in_gaps
from jaxclear.simulation.indeterminate import unmoved


def collared(model: Model) -> tuple[str, ...]:
    """The bearings with collars that always touch."""
    gaps = in_gaps(model)
    return tuple(name for name, gap in gaps.items() if getattr(gap, "flange", None) is not None)


def unheld(model: Model) -> tuple[str, ...]:
    """The bearings without collars that always touch."""
    return tuple(name for name, gap in in_gaps(model).items() if gap.left(0.0) is not None)


def by_others(now: Instant, mechanism: Mechanism, names: tuple[str, ...]) -> list[bool]:
    """Whether other joints may hold these along their axis: what they carry there is not unique."""
    redundancy, joints = now.model.system.topology.redundancy, touching(now.model.system)
    open_ = set() if redundancy is None else {*redundancy.joints}
    for reactions in unmoved(now, mechanism):
        own = zip(joints, reactions, strict=True)
        open_ |= {one.name for one, reaction in own if not sp.is_zero(reaction.force[2])}
    return [name in open_ for name in names]


def sliding(system: System) -> tuple[str, ...]:
    """The bearings without collars whose journals move in their gaps."""
    gaps = {name: one.joint for name, one in system.bearings.items()}
    return tuple(name for name, gap in gaps.items() if gap.left(0.0) is not None)


def pressed(reports: list[ContactReport], counted: Iterable[bool]) -> Float[Array, "2 joints"]:
    """Of joints that are told of at a look: force along the axis, if that is counted, and that of
    its contacts [N]."""
    forces = [report.force[2] if own else 0.0 for report, own in zip(reports, counted, strict=True)]
    along = [abs(jnp.asarray(force, float)) for force in forces]
    return jnp.stack([jnp.stack(along), jnp.stack([jnp.sum(r.normal_force) for r in reports])])


def share_along(found: Float[Array, "looks 2 joints"]) -> Float[Array, " joints"]:
    """By joint the share of all its forces that acts along its axis."""
    along, across = jnp.sum(found, axis=0)
    return safe_divide(along, along + across)


def left(system: System, reports: dict[str, ContactReport]) -> Float[Array, " joints"]:
    """By joint how much of its bearing a journal has left at a look, in lengths of the bearing."""
    gaps = [system.bearings[name].joint for name in reports]
    shares = [
        gap.left(report.offset[2]) for gap, report in zip(gaps, reports.values(), strict=True)
    ]
    return jnp.stack([jnp.asarray(share, float) for share in shares])
