"""Mechanisms from URDF and MJCF: bodies with their inertias, joints with their axes, and gravity;
what acts on joints is in `model_loads`. What is not taken over is named in a warning.
"""

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np

from jaxclear.components.body import Connection
from jaxclear.components.drive import Held
from jaxclear.components.load import Gravity
from jaxclear.files.model_equalities import equalities_of
from jaxclear.files.model_loads import STOPS, gives_way, loads_of
from jaxclear.files.model_tree import Tree
from jaxclear.files.mujoco_model import Compiled, compiled, names_of, not_taken_over
from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import check_flags, check_known
from jaxclear.ground.warning import warn
from jaxclear.multibody.exchange import without_loads_on
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.topology import grow

__all__ = ["ImportedSoft", "NotImported", "read_mjcf", "read_urdf"]


class NotImported(UserWarning):
    """Something in a model that the mechanism does not have."""


class ImportedSoft(UserWarning):
    """Something in a model that gives way under the model's own weight."""


@answering
def read_urdf(
    path: Any, *, floating: bool = False, stops: str = "steady", sticking: bool = False
) -> Mechanism:
    """The mechanism in a URDF file, root fixed in the ground, or `floating`; as `read_mjcf`."""
    return _mechanism(compiled(path, floating=floating), stops, sticking)


@answering
def read_mjcf(
    path: Any, *, floating: bool = False, stops: str = "steady", sticking: bool = False
) -> Mechanism:
    """The mechanism in a file of MJCF (or URDF), with the names of the file.

    Bodies have the frames, inertias and joints of the model: hinges are `Revolute`, slides
    `Prismatic`, balls `Spherical`, free joints `Free`, welds `Fixed`; coordinates count from the
    model's reference configuration. Gravity becomes a load; of hinges and slides damping and
    stiffness a `JointSpring`, armature a `RotorInertia`, dry friction a `JointFriction`, limits a
    `JointStop`. Active equalities `connect` are `Spherical` joints and `weld` `Fixed` ones that
    close loops, linear ones between joints (URDF's `mimic`) a `Ratio`; a joint that one holds alone
    is driven (`drive.Held`). Bodies without inertia that are welded become part of what they are
    welded to. Several joints of one body get bodies between them, of 1e-12 of its mass. Geometries
    and their names are read by `read_shapes`.

    - `path`: of the file. `jaxclear[import]` installs MuJoCo, which reads it.
    - `floating`: roots without a joint get a free one.
    - `stops`: what limits, soft constraints in MuJoCo and springs here, have of it. "steady": under
      weight and springs of the model's tree they give way as far. "impact": they stop what runs
      into them over the same way and time, and give way 1 / (1 - d) times as far under a steady
      load, for MuJoCo's impedance d (20 times by default).
    - `sticking`: dry friction sticks, as a `PlainBearing` or `Slideway` with `Coulomb`, for
      `MoreauJean` and `NonColliding`; otherwise it creeps, as fast as in MuJoCo.

    A `NotImported` warning names what is not taken over: contacts, actuators, tendons, other
    equalities, a reference configuration that is not kept, and what a ball or a free joint has of
    the above. An `ImportedSoft` warning says what gives way under weight and springs, and by how
    much. Raises `ValueError` with a sentence.
    """
    return _mechanism(compiled(path, floating=floating), stops, sticking)


def _mechanism(read: Compiled, stops: str = "steady", sticking: bool = False) -> Mechanism:
    check_known("stops", stops, STOPS)
    check_flags("the import", sticking=sticking)
    model = read.model
    bodies, joints = names_of(model)
    tree = Tree(model, bodies, joints, sticking)
    held = equalities_of(model, tree)
    _warn(read, "not taken over", [*not_taken_over(read, joints), *held.missing], NotImported)
    if not tree.bodies:
        raise ValueError(f"{read.name} has no body with mass.")
    loads = without_loads_on(dict(loads_of(model, joints, stops, sticking)), tuple(held.held))
    _warn(read, "gives way at rest", gives_way(model, joints, loads), ImportedSoft)
    if np.any(model.opt.gravity):
        loads["gravity"] = Gravity(tuple(map(float, model.opt.gravity)))
    connections = _held(tree.connections, held.held) | held.connections
    # Where an equality holds a free body, its place is only near: the loop decides.
    start = {name: place for name, place in tree.start.items() if name not in held.free}
    near = {name: place for name, place in tree.start.items() if name in held.free} | held.turned
    grown = grow(tree.bodies, connections)
    guess = {name: place for name, place in near.items() if grown.branch_of(name) is not None}
    return Mechanism(
        tree.bodies, connections, loads, couplings=held.couplings, start=start, guess=guess
    )


def _held(connections: dict[str, Connection], places: dict[str, float]) -> dict[str, Connection]:
    """Connections some of whose joints are held at a coordinate [rad, m]."""
    found = dict(connections)
    for name, place in places.items():
        own = connections[name]
        joint: Any = own.joint
        held = dataclasses.replace(joint, drive=Held(place))
        found[name] = Connection(held, own.parent, own.child)
    return found


def _warn(read: Compiled, what: str, said: Iterable[str], kind: type[Warning]) -> None:
    found = "; ".join(said)
    if found:
        warn(f"{read.name}: {what}: {found}.", kind)
