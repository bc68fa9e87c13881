"""What is read from a mechanism over positions of its drives: where its bodies stand, where its
journals lie, and what holds them.

It answers to the same names as a run, so a response that reads places serves both.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.components.body import Marker
from jaxclear.ground import sparse as sp
from jaxclear.ground.arguments import check_name
from jaxclear.ground.datasets import Column, dataset, write_csv
from jaxclear.ground.printing import AbstractShown
from jaxclear.ground.wording import listed
from jaxclear.multibody.kinematics import relative_motion
from jaxclear.multibody.start_constraints import source
from jaxclear.results.histories import (
    AbstractHistory,
    MarkerHistory,
    marker,
    measured_field,
    quaternions,
)
from jaxclear.results.state_history import check_single, single, take_one
from jaxclear.statics.equilibrium import Carried, Resting, case_of, rest_at
from jaxclear.statics.quasi_static import Posed, stand_at

# Share of a free motion from which on a freedom takes part in it [1].
LOOSE = 1e-3


class BodyPoses(AbstractHistory):
    """Poses of a body in the ground frame at each position of the drives.

    Args:
        com: position of the centre of mass [m], shape (positions, 3).
        rotation: axes of the body in the ground frame [1], shape (positions, 3, 3).
        origin: position of the origin of the body frame [m], shape (positions, 3).
    """

    com: Float[Array, "positions 3"] = measured_field("m")
    rotation: Float[Array, "positions 3 3"] = measured_field("1")
    origin: Float[Array, "positions 3"] = measured_field("m")


class Positions(AbstractShown):
    """A mechanism at rest at positions of its drives.

    Args:
        scene: the mechanism with the joints that are held.
        position: coordinates of the drives [rad, m], shape (positions, drives), in the order of
            `scene.held`.
        coordinates: coordinates of the tree [rad, m], shape (positions, q).
        seats: by joint with clearance where its journal rests, shape (positions, 5): offset [m] in
            the bearing's axes, slope of its axis [1].
        is_solved: whether the mechanism closes and each journal rests where its reaction presses
            it, shape (positions,).
        side: sign of the loads, 1 or -1 [1].
        moving: which numbers of each seat are not zero by construction.
        other: the positions under reversed loads; None where they were not computed.
        carried: forces that hold the mechanism, where it rests at least potential energy; else
            None.
    """

    scene: Posed
    position: Float[Array, "positions drives"]
    coordinates: Float[Array, "positions q"]
    seats: dict[str, Float[Array, "positions 5"]]
    is_solved: Array
    side: float = eqx.field(static=True)
    # Numbers of each seat that are not zero by construction.
    moving: dict[str, tuple[int, ...]] = eqx.field(static=True)
    other: "Positions | None" = None
    carried: Carried | None = None

    def __getitem__(self, index: int) -> "Positions":
        """One of a batch that `jax.vmap` has made of `PositionProblem.positions`.

        Args:
            index: number in the batch; negative numbers count from the end.

        Returns:
            The positions.

        Raises:
            ValueError: if this is no batch.
            IndexError: if the batch has fewer.
        """
        return take_one(self, self.is_solved, index)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences on positions that are not unique, empty for none.

        They name parts that no load presses or holds, and unstable equilibria of which one side was
        taken.
        """
        check_single(self.is_solved)
        if self.carried is None:
            return ()
        sentences, count = [], len(self.position)
        topology = self.scene.mechanism.topology
        free = np.asarray(self.carried.loose) > LOOSE
        for branch in topology.branches:
            many = int(np.sum(np.any(free[:, branch.speeds], axis=1)))
            if many:
                what = f'body "{branch.body}"' if branch.connection is None else f'"{branch.name}"'
                sentences.append(
                    f"{what} moves freely at {many} of {count} positions: in one of its freedoms "
                    "nothing presses or holds it, and of the places that it may take one was taken."
                )
        split = int(np.sum(np.asarray(self.carried.split)))
        if split:
            sentences.append(
                f"at {split} of {count} positions the equilibrium next to the start is unstable; "
                "the mechanism went to one of its two sides. A guess on one side chooses."
            )
        return tuple(sentences)

    def _summary(self):
        if np.ndim(self.is_solved) > 1:
            return f"A batch of {len(self.is_solved)} at positions each; positions[i] is one."
        places = ", ".join(
            f"{name} from {values.min():.4g} to {values.max():.4g} {self._unit_of(name)}"
            for name, values in zip(self.scene.drives, np.asarray(self.position).T, strict=True)
        )
        both = ", also under reversed loads" if self.other is not None else ""
        missing = int(np.sum(~np.asarray(self.is_solved)))
        note = f" {missing} were not found." if missing else ""
        many = f"{len(self.position)} position{'s' if len(self.position) > 1 else ''}"
        first = f"{many}{both}: {places or 'at rest under its loads'}.{note}"
        return " ".join([first, *self.warnings])

    @property
    def reversed(self) -> "Positions":
        """The positions under reversed loads.

        Raises:
            ValueError: if they were not computed (`reverse_loads=True`).
        """
        if self.other is None:
            raise ValueError(
                "positions under reversed loads were not asked for; ask with reverse_loads=True."
            )
        return self.other

    def body(self, name: str) -> BodyPoses:
        """Poses of a body.

        Args:
            name: name of the body.

        Returns:
            The `BodyPoses`.

        Raises:
            ValueError: if there is no such body.
        """
        check_name("body", name, self.scene.mechanism.bodies, " in this mechanism")
        com = sp.vec3(self.scene.mechanism.bodies[name].com)

        def one(now):
            index = now.system.topology.index(name)
            pose = now.motions[index].pose.after(now.system.links[index].frame)
            return sp.stack(pose.point(com)), _dense(pose.rotation), sp.stack(pose.translation)

        return BodyPoses(*self._over(one))

    def marker(self, body: str | Marker, at: Any = None) -> MarkerHistory:
        """Position and rotation of a point of a body in the ground frame.

        Args:
            body: name of the body, or a `Marker`.
            at: position of the point in the body frame [m], 2 or 3 numbers; not beside a `Marker`.

        Returns:
            A `MarkerHistory` with `position` [m] and `rotation`.

        Raises:
            ValueError: if there is no such body, or `at` is given beside a `Marker`.
        """
        return marker(self.body, self.scene.mechanism, body, at)

    def coordinate(self, name: str) -> Float[Array, "positions ..."]:
        """Coordinates of a joint or body over the positions.

        Args:
            name: name of a connection of the tree, a joint or motor that is held, or a body that
                only joints with clearance connect; of any joint where the mechanism rests at least
                potential energy.

        Returns:
            Coordinate [rad, m], shape (positions,); (positions, coordinates) where there are
            several.

        Raises:
            ValueError: if there is no such joint, or it closes a loop and has no coordinates.
        """
        check_single(self.is_solved)
        scene = self.scene
        branches = {branch.name: branch for branch in scene.mechanism.topology.branches}
        names = [*scene.mechanism.connections, *branches, *scene.drives]
        check_name("joint or floating body", name, dict.fromkeys(names), " in this mechanism")
        if name in scene.drives:
            return self.position[:, scene.drives.index(name)]
        branch = branches.get(name)
        if branch is None and scene.loose:
            return single(self._over(lambda now: sp.stack(_read(scene.mechanism, now, name))))
        if branch is None:
            raise ValueError(
                f'joint "{name}" closes a loop and has no coordinates of its own; those with are '
                f"{listed(list(branches))}."
            )
        return single(self.coordinates[:, branch.coordinates])

    def offset(self, joint: str) -> Float[Array, "positions 3"]:
        """Position of a journal in its gap, in the bearing's axes.

        Args:
            joint: name of a joint with clearance.

        Returns:
            Offset [m], shape (positions, 3).

        Raises:
            ValueError: if there is no such joint.
        """
        check_single(self.is_solved)
        check_name("joint", joint, self.seats, " with clearance in this mechanism")
        return self.seats[joint][:, :3]

    def reaction(self, joint: str) -> Float[Array, "positions 6"]:
        """Force and torque on a joint's child about its marker, without friction.

        Args:
            joint: name of the joint.

        Returns:
            Force [N] and torque [N m] in the axes of the parent's marker, shape (positions, 6).

        Raises:
            ValueError: if there is no such joint.
        """
        check_name("joint", joint, self.scene.mechanism.connections, " in this mechanism")
        return self._over(lambda now: sp.stack([x for p in now.reactions[joint] for x in p]))

    def to_dataset(self) -> Any:
        """Drives, bodies and journals over the positions.

        Returns:
            An xarray Dataset with units and provenance; names "reversed ..." hold values under
            reversed loads, where these were computed.
        """
        columns = self._answer_columns()
        if self.other is not None:
            other = self.reversed._answer_columns().items()
            drives = self.scene.drives
            columns |= {f"reversed {name}": values for name, values in other if name not in drives}
        coordinates = {
            "axis": Column(("axis",), ["x", "y", "z"]),
            "component": Column(("component",), ["w", "x", "y", "z"]),
        }
        mechanism = str(self.scene.mechanism)
        return dataset(columns, coordinates, what="positions", mechanism=mechanism)

    def to_csv(self, path: Any) -> Path:
        """Write a CSV file: a row for each position, names with units, every digit.

        Args:
            path: name of the file.

        Returns:
            The path of the file.
        """
        return write_csv(self.to_dataset(), path)

    def _answer_columns(self) -> dict[str, Column]:
        scene, columns = self.scene, {}
        over, axis = ("position",), ("position", "axis")
        for name in scene.drives:
            columns[name] = Column(
                over, self.coordinate(name), self._unit_of(name), "coordinate of a drive"
            )
        for name in scene.mechanism.bodies:
            pose = self.body(name)
            columns[f"{name}.com"] = Column(axis, pose.com, "m", f"centre of mass of {name}")
            turn = np.asarray(quaternions(pose.rotation))
            meaning = f"orientation of {name}, scalar first"
            columns[f"{name}.quaternion"] = Column(("position", "component"), turn, "1", meaning)
        for name in self.seats:
            meaning = f"journal against bearing of {name}, bearing axes"
            columns[f"{name}.offset"] = Column(axis, self.offset(name), "m", meaning)
        columns["found"] = Column(over, self.is_solved, "1", "whether the mechanism closes")
        return columns

    def _unit_of(self, name: str) -> str:
        if name in self.scene.motors:
            return "rad"
        joint: Any = self.scene.mechanism.connections[name].joint
        return joint.units[0]

    def _over(self, one: Callable[[Any], Any]) -> Any:
        check_single(self.is_solved)
        carried = self.carried
        if carried is not None:

            def rests(position, q, closing, pushes, angles):
                scene = self.scene.at(position)
                case = case_of(scene, carried.side, angles, carried.rounded)
                return one(rest_at(case, q, closing, pushes))

            unknowns = carried.closing, carried.pushes, carried.angles
            return jax.vmap(rests)(self.position, self.coordinates, *unknowns)

        def row(position, q, seats):
            scene = self.scene.at(position)
            numbers = {name: open_seat(seats[name], moving) for name, moving in self.moving.items()}
            return one(stand_at(scene, [*q], numbers, self.side))

        return jax.vmap(row)(self.position, self.coordinates, self.seats)


def _read(mechanism: Any, now: Resting, name: str) -> tuple:
    """Coordinates of a joint outside the tree [rad, m]: of one with clearance those of the ideal
    joint that it would be."""
    where = source(mechanism, now.system, name)
    return where.joint.coordinates_at(relative_motion(where.closure, now.motions)[1])


def open_seat(seat: Array, moving: tuple[int, ...]) -> tuple:
    """The five numbers of a seat, those that are zero by construction as such."""
    return tuple(seat[k] if k in moving else 0 for k in range(len(seat)))


def _dense(rotation: sp.Mat) -> Float[Array, "3 3"]:
    return jnp.stack([sp.stack(row) for row in rotation])
