"""Another joint in the place of one: which fit, and what keeps the rest as it was.

An ideal joint in the spanning tree starts at its home unless told otherwise; the same joint with
clearance leaves its body afloat, to be assembled from anywhere. So its coordinate is given as a
guess, and its speed where nothing else tells it.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxclear.components.body import Body, Connection
from jaxclear.components.clearance import AbstractClearance
from jaxclear.components.joint import AbstractDrivenJoint, AbstractJoint
from jaxclear.components.joint.base import drive_of
from jaxclear.components.load import AbstractStateLoad
from jaxclear.ground.arguments import check_name, expect
from jaxclear.ground.wording import listed
from jaxclear.multibody.pose_rows import closing_rows
from jaxclear.multibody.topology import Topology, coordinate_joint, free_joint, grow_tree

# Twists that say no more than others [m, 1]: rounding.
SAME = 1e-9


def exchange_joint(
    connections: Mapping[str, Connection], bodies: dict[str, Body], name: str, joint: Any
) -> dict[str, Connection]:
    """The connections with another joint between the same two markers; a drive is kept.

    Args:
        connections: of the mechanism, by name.
        bodies: by name; their inertias say in which space they move.
        name: connection whose joint is replaced.
        joint: ideal joint or joint with clearance.

    Raises:
        ValueError: there is no such connection, or the joint does not fit.
    """
    check_name("joint", name, connections, " in this mechanism")
    target = "one of jaxclear.joint or jaxclear.clearance"
    expect(joint, (AbstractJoint, AbstractClearance), f'what is put in place of "{name}"', target)
    old = connections[name]
    drive = drive_of(old.joint)
    if drive is not None and drive_of(joint) is None:
        if not isinstance(joint, AbstractDrivenJoint):
            raise ValueError(
                f'joint "{name}" is driven, and a {type(joint).__name__} takes no drive; turn it '
                "by a torque (load.JointTorque) in a joint without a drive, or give play to "
                "another joint."
            )
        undriven: Any = joint
        joint = dataclasses.replace(undriven, drive=drive)
    result = dict(connections)
    result[name] = Connection(joint, old.parent, old.child)
    _check_fits(name, old.joint, coordinate_joint(name, bodies, result), joint, connections, bodies)
    return result


def _check_fits(
    name: str, old: Any, ideal: AbstractJoint, joint: Any, connections: Any, bodies: Any
) -> None:
    """That one of two joints constrains no more than the other does."""
    before = coordinate_joint(name, bodies, dict(connections))
    if before.rows is None or ideal.rows is None:
        directions = [_twists_at_home(joint) for joint in (before, ideal)]
        if np.linalg.matrix_rank(np.concatenate(directions), SAME) == max(map(len, directions)):
            return
    else:
        rows, new_rows = set(before.rows), set(ideal.rows)
        if rows <= new_rows or new_rows <= rows:
            return
    text = "" if ideal is joint else f", which without its play is a {_name_of_kind(ideal)}"
    raise ValueError(
        f'joint "{name}" is a {type(old).__name__}; a {type(joint).__name__}{text} moves in other '
        "directions and does not fit in its place."
    )


def _twists_at_home(joint: AbstractJoint) -> np.ndarray:
    """The twists of a joint's speeds at home."""
    columns = joint.columns(joint.home)
    return np.array([[*x.linear, *x.angular] for x in columns], float).reshape(-1, 6)


def _name_of_kind(joint: AbstractJoint) -> str:
    return type(joint).__name__.removeprefix("Permanent")


def start_arguments(
    before: Topology,
    connections: dict[str, Connection],
    bodies: dict[str, Body],
    name: str,
    values: Mapping[str, Mapping[str, Any]],
    first: tuple[str, ...],
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Guess and speeds such that the mechanism with the exchanged joint starts where it stood.

    Args:
        before: topology with the old joint.
        connections: with the new joint.
        bodies: by name.
        name: connection whose joint was exchanged.
        values: "start", "guess" and "speeds" of the mechanism, each by name.
        first: connections that come first in the tree.

    Raises:
        ValueError: a body in space is held only by a joint that acts in a plane.
    """
    guess, speeds = dict(values["guess"]), dict(values["speeds"])
    joint, after = connections[name].joint, grow_tree(bodies, connections, first=first)
    if before.branch_of(name) is None or not isinstance(joint, AbstractClearance):
        return guess, speeds
    afloat = {b.body for b in after.branches if b.connection is None}
    afloat -= {b.body for b in before.branches if b.connection is None}
    form = coordinate_joint(name, bodies, connections)
    for body in sorted(afloat):
        missing = [row for row in closing_rows(form) if row not in joint.ideal_rows]
        if missing and len(free_joint(bodies[body]).home) > len(missing):
            raise ValueError(
                f'joint "{name}" is to be a {type(joint).__name__}, which acts in a plane, and '
                f'nothing else holds body "{body}" out of it (rows {listed(missing)}); take a '
                "joint that acts in space, such as a JournalBearing with a flange."
            )
    # A home counts where nothing else is guessed, as it did while the tree carried the joint.
    if not guess and name not in values["start"] and not afloat & {*values["start"]}:
        guess[name] = form.home
    if afloat and name not in speeds and not afloat & {*speeds}:
        speeds[name] = (0.0,) * len(form.columns(form.home))
    return guess, speeds


def without_loads_on(loads: Mapping[str, Any], joints: tuple[str, ...]) -> dict[str, Any]:
    """The loads but for those on the coordinates of some joints."""
    acts = lambda load: isinstance(load, AbstractStateLoad) and {*load.coordinates()} & {*joints}
    return {name: load for name, load in loads.items() if not acts(load)}


def at_rest_under(loads: Mapping[str, Any], fixed: tuple[str, ...]) -> dict[str, Any]:
    """The loads that say where a mechanism stands of which some joints are held: neither those on
    the coordinates of these nor inertias."""
    idle = lambda x: isinstance(x, AbstractStateLoad) and x.inertia_along() is not None
    return {n: load for n, load in without_loads_on(loads, fixed).items() if not idle(load)}
