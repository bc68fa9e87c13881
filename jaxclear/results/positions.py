"""What is read from a mechanism over positions of its drives: where its bodies stand, where its
journals lie, and what holds them.

It answers to the same names as a run, so a response that reads places serves both.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.body import Marker
from jaxclear.formulations.quasi_static import Posed, Standing, standing
from jaxclear.ground import sparse as sp
from jaxclear.ground.arguments import check_known
from jaxclear.ground.wording import listed

__all__ = ["Positions"]


class BodyPoses(eqx.Module):
    """Bodies in the ground frame at each position: `com` place [m] of the centre of mass,
    `rotation` the body's axes in the ground's, `origin` place of the body frame [m]."""

    com: Float[Array, "positions 3"]
    rotation: Float[Array, "positions 3 3"]
    origin: Float[Array, "positions 3"]


class Positions(eqx.Module):
    """A mechanism at rest at positions of its drives.

    `position` (positions, drives) are the drives' coordinates [rad, m] in the order of
    `scene.held`, `coordinates` those of the tree, `seats` of each joint with clearance where its
    journal lies (positions, 5): offset [m] in the bearing's axes, slope of its axis [1].
    `found` (positions,): whether the mechanism closes and every seat is the one of its reaction.
    """

    scene: Posed
    position: Float[Array, "positions drives"]
    coordinates: Float[Array, "positions q"]
    seats: dict[str, Float[Array, "positions 5"]]
    found: Array
    side: float = eqx.field(static=True)
    # Numbers of each seat that are not zero by construction.
    moving: dict[str, tuple[int, ...]] = eqx.field(static=True)
    other: "Positions | None" = None

    @property
    def reversed(self) -> "Positions":
        """The same under reversed loads."""
        if self.other is None:
            raise ValueError(
                "positions under reversed loads were not asked for; ask with both_ways=True."
            )
        return self.other

    def body(self, name: str) -> BodyPoses:
        """Where a body stands."""
        check_known("body", name, self.scene.mechanism.bodies, " in this mechanism")
        com = sp.vec3(self.scene.mechanism.bodies[name].com)

        def one(now):
            index = now.system.topology.index(name)
            pose = now.motions[index].pose.after(now.system.links[index].frame)
            return sp.stack(pose.point(com)), _dense(pose.rotation), sp.stack(pose.translation)

        return BodyPoses(*self._over(one))

    def marker(self, body: str, at: Any) -> Float[Array, "positions 3"]:
        """Place of a point of a body, given in the body frame [m], in the ground frame."""
        motion = self.body(body)
        place = sp.stack(Marker(body, at).pose().translation)
        return motion.origin + jnp.einsum("tij,j->ti", motion.rotation, place)

    def coordinate(self, name: str) -> Float[Array, "positions q"]:
        """Coordinates of a connection of the tree, or of one that is held [rad, m]."""
        scene = self.scene
        check_known("joint", name, scene.mechanism.connections, " in this mechanism")
        if name in scene.held:
            return self.position[:, [scene.held.index(name)]]
        branch = scene.mechanism.topology.branch_of(name)
        if branch is None:
            names = [b.name for b in scene.mechanism.topology.branches]
            raise ValueError(
                f'joint "{name}" closes a loop and has no coordinates of its own; those with are '
                f"{listed(names)}."
            )
        return self.coordinates[:, branch.coordinates]

    def offset(self, joint: str) -> Float[Array, "positions 3"]:
        """Where a journal lies in its gap [m], in the bearing's axes."""
        check_known("joint", joint, self.seats, " with clearance in this mechanism")
        return self.seats[joint][:, :3]

    def reaction(self, joint: str) -> Float[Array, "positions 6"]:
        """Force [N] and torque [N m] on a joint's child about its marker, in the axes of the
        parent's marker; without friction."""
        check_known("joint", joint, self.scene.mechanism.connections, " in this mechanism")
        return self._over(lambda now: sp.stack([x for p in now.reactions[joint] for x in p]))

    def _over(self, one: Callable[[Standing], Any]) -> Any:
        def row(position, q, seats):
            scene = self.scene.at(position)
            own = {name: opened(seats[name], moving) for name, moving in self.moving.items()}
            return one(standing(scene, [*q], own, self.side))

        return jax.vmap(row)(self.position, self.coordinates, self.seats)


def opened(seat: Array, moving: tuple[int, ...]) -> tuple:
    """The five numbers of a seat, those that are zero by construction as such."""
    return tuple(seat[k] if k in moving else 0 for k in range(len(seat)))


def _dense(rotation: sp.Mat) -> Float[Array, "3 3"]:
    return jnp.stack([sp.stack(row) for row in rotation])
