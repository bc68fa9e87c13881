"""Rigid bodies, frames fixed on them, and the connections between them.

Coordinates and inertias are given in the body's own frame, whose place on the body the user
chooses. What is given with two components is planar: its third component is known to be zero before
tracing.
"""

from typing import TYPE_CHECKING, Any, TypeAlias

import equinox as eqx
import jax
import numpy as np

from jaxclear.components.clearance import AbstractClearance
from jaxclear.components.joint import AbstractJoint
from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import (
    AXES,
    Pose,
    frame_in_plane,
    frame_with_axis,
    rotation_from_quaternion,
    rotation_z,
)
from jaxclear.ground.printing import in_a_line, number_in_words
from jaxclear.ground.quantity import (
    AbstractQuantified,
    Scalar,
    as_vector,
    concrete,
    quantity,
    vector,
)
from jaxclear.ground.wording import described

GROUND = "ground"
if TYPE_CHECKING:
    # Which of the two a connection has is known by its place in the topology, not by its type.
    AnyJoint: TypeAlias = Any
else:
    AnyJoint = AbstractJoint | AbstractClearance
# By how much, relatively, a thin plate's moments may miss their sum through rounding.
ROUNDING = 1e-9


def _as_inertia(value: Any) -> Any:
    value = (
        tuple(value)
        if isinstance(value, (tuple, list)) or getattr(value, "ndim", 0) == 1
        else (value,)
    )
    return as_vector(value)


class Body(AbstractQuantified):
    """A rigid body.

    Args:
        mass: mass [kg], > 0.
        inertia: inertia about the centre of mass in body axes [kg m^2]: 1 number (about z, for
            planar motion), 3 (xx, yy, zz) or 6 (xx, yy, zz, xy, xz, yz). Products are elements of
            the matrix: xy = -integral of x y dm.
        com: centre of mass in the body frame [m], 2 or 3 numbers; by default the origin.

    Raises:
        ValueError: if the inertia is not positive, or one principal moment is larger than the sum
            of the others.
    """

    mass: Scalar = quantity(unit="kg", above=0)
    inertia: Any = quantity(
        unit="kg m^2",
        converter=_as_inertia,
        counts=(1, 3, 6),
        wanted="1 number (about z, planar), 3 (xx, yy, zz) or 6 (xx, yy, zz, xy, xz, yz) [kg m^2]",
    )
    com: tuple | None = vector(None, "m", counts=(2, 3))

    def __check_init__(self):
        values = [concrete(value) for value in self.inertia]
        if None in values or not np.all(np.isfinite(values)):
            return
        if len(values) == 1:
            if values[0] <= 0:
                raise ValueError(
                    f"a Body has inertia {values[0]} kg m2 about z; it must be positive."
                )
            return
        moments = np.linalg.eigvalsh(np.array(jax.tree.map(float, self.inertia_matrix())))
        if moments[0] <= 0:
            raise ValueError(
                f"a Body has principal moments of inertia {moments.round(9)} kg m2; all three must "
                "be positive (the matrix must be positive definite)."
            )
        if moments[0] + moments[1] < moments[2] * (1 - ROUNDING):
            raise ValueError(
                f"a Body has principal moments of inertia {moments} kg m2; none must be larger "
                "than the sum of the other two."
            )

    def inertia_matrix(self) -> sp.Mat:
        """Inertia about the centre of mass as a sparse matrix; what is not given is structurally
        zero.
        """
        if len(self.inertia) == 1:
            return (sp.ZERO, sp.ZERO, (0, 0, self.inertia[0]))
        xx, yy, zz = self.inertia[:3]
        xy, xz, yz = self.inertia[3:] or (0, 0, 0)
        return ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))


class Marker(AbstractQuantified):
    """A frame fixed on a body: origin `at` [m] in the body frame, z axis along `axis`.

    Along an axis in the body's x-y plane the frame's x axis lies in that plane, a quarter turn
    ahead, as it does along "x" and "y": so parts that are joined in the plane stay in it.

    Args:
        body: name of the body, or "ground".
        at: origin in the body frame [m], 2 or 3 numbers; the body's origin by default.
        axis: direction of the marker's z axis in the body frame [1]: "x", "y", "z", "-x", "-y" or
            "-z" (known before tracing, costs nothing), or numbers of any length: 2 in the x-y
            plane, or 3. "z" by default.
        quaternion: orientation in the body frame (w, x, y, z) [1], in place of an axis; none by
            default.
        angle: turn of the frame about the body's z axis [rad], so that an inclination is one number
            that can vary; None by default, which costs nothing.

    Raises:
        ValueError: for an axis or a quaternion that is zero, for both of them, or for an axis of
            numbers along -z.
    """

    body: str = eqx.field(static=True)
    at: tuple | None = vector(None, "m", counts=(2, 3))
    # Of an axis of numbers "x" where it lies in the plane, "z" elsewhere.
    named_axis: str = eqx.field(static=True, default="z")
    axis: tuple | None = vector(None, "1", counts=(2, 3))
    quaternion: tuple | None = vector(None, "1", counts=(4,))
    angle: Scalar | None = quantity(None, "rad")

    def __init__(self, body: str, at=None, axis="z", quaternion=None, angle=None):
        self.body, self.at, self.quaternion, self.angle = body, at, quaternion, angle
        named = isinstance(axis, str)
        self.named_axis, self.axis = (axis, None) if named else (_plane_of(axis), axis)

    def __check_init__(self):
        if self.named_axis not in AXES:
            raise ValueError(
                f'the axis of a marker on "{self.body}" is {self.named_axis!r}; it may be one of '
                f"{', '.join(AXES)} or 3 numbers."
            )
        if self.quaternion is not None and (self.axis is not None or self.named_axis != "z"):
            raise ValueError(
                f'a marker on "{self.body}" takes a quaternion (w, x, y, z) or an axis, not both.'
            )
        for what, direction in (("axis", self.axis), ("quaternion", self.quaternion)):
            if direction is not None and all(concrete(x) == 0 for x in direction):
                raise ValueError(
                    f'the {what} of a marker on "{self.body}" is zero and points nowhere; give a '
                    "direction."
                )
        if (
            self.axis is not None
            and concrete(self.axis[0]) == 0 == concrete(self.axis[1])
            and not self.axis[-1] > 0
        ):
            raise ValueError(
                f'the axis of a marker on "{self.body}" points along -z, where no frame is near: '
                'write axis="-z".'
            )

    def pose(self) -> Pose:
        """The marker in the body frame."""
        if self.quaternion is not None:
            rotation = rotation_from_quaternion(self.quaternion)
        elif self.axis is not None:
            rotation = (frame_in_plane if self.named_axis == "x" else frame_with_axis)(self.axis)
        else:
            rotation = AXES[self.named_axis]
        if self.angle is not None:
            rotation = sp.product(rotation_z(self.angle), rotation)
        return Pose(rotation, sp.vec3(self.at))


def _plane_of(axis: Any) -> str:
    """ "x" for the numbers of a direction in the x-y plane, "z" for anything else."""
    try:
        x, y, z = (*axis, 0.0)[:3]
        flat = concrete(z) == 0 and not concrete(x) == 0 == concrete(y)
    except (TypeError, ValueError):
        return "z"
    return "x" if flat else "z"


@in_a_line.register
def _(marker: Marker, unit: Any = None) -> str:
    """The body, and where on it: `"rod" at (0.12, 0) m along x`."""
    place = "" if marker.at is None else f" at {number_in_words(marker.at)} m"
    axis = f" along {marker.named_axis}" if marker.named_axis != "z" else ""
    axis = axis if marker.axis is None else f" along {number_in_words(marker.axis)}"
    turn = marker.quaternion
    turn_text = "" if turn is None else f" turned by {number_in_words(turn)}"
    if marker.angle is not None:
        turn_text += f" turned by {number_in_words(marker.angle)} rad about z"
    return f'"{marker.body}"{place}{axis}{turn_text}'


class Connection(AbstractQuantified):
    """A joint between a marker on the parent and a marker on the child.

    Coordinates measure the child relative to the parent. A body's name stands for a marker with the
    axis of the other side's marker, or with `axis` where both sides are names.

    Args:
        joint: ideal joint, one of `jaxclear.joint`, or joint with clearance, one of
            `jaxclear.clearance`.
        parent: name of the parent body, "ground", or a `Marker` on it.
        child: name of the child body, "ground", or a `Marker` on it; a name: at the origin of the
            child.
        at: place on the parent [m], 2 or 3 numbers in its frame, where `parent` is a name; by
            default the origin.
        axis: z axis of the joint where both sides are names: "x", "y", "z", "-x", "-y", "-z", or a
            direction of 2 or 3 numbers [1]; "z" by default.

    Raises:
        ValueError: if a side is neither a name nor a marker, or if `at` or `axis` is given beside a
            marker that already says it.
    """

    joint: AnyJoint
    parent: Marker
    child: Marker

    def __init__(
        self,
        joint: AnyJoint,
        parent: str | Marker,
        child: str | Marker,
        at: Any = None,
        axis: Any = None,
    ):
        for side, end in (("parent", parent), ("child", child)):
            if not isinstance(end, (str, Marker)):
                raise ValueError(
                    f"Connection has {side} = {described(end)}; it must be the name of a body, "
                    '"ground", or a jaxclear.Marker.'
                )
        if at is not None and isinstance(parent, Marker):
            raise ValueError(
                f'a joint on "{parent.body}" gives `at` beside a marker; put the place into '
                "the marker."
            )
        markers = [end for end in (parent, child) if isinstance(end, Marker)]
        if markers and axis is not None:
            places = " and ".join(f'"{marker.body}"' for marker in markers)
            raise ValueError(
                f"a joint with a marker on {places} is given an axis beside it; put the axis into "
                "the markers. A body's name beside a marker takes its axis."
            )
        in_plane = any(m.axis is not None and m.named_axis == "x" for m in markers)
        behind = [m for m in markers if m.named_axis in ("-x", "-y")]
        if in_plane and behind:
            named = behind[0].named_axis
            raise ValueError(
                f'a joint on "{behind[0].body}" goes along "{named}" there, and along numbers on '
                "the other body, against which that frame is turned over; write the numbers as a "
                f'turn: axis="{named}" and the angle about z.'
            )
        frame = _orientation(markers[0]) if markers else {"axis": "z" if axis is None else axis}
        self.joint = joint
        self.parent = parent if isinstance(parent, Marker) else Marker(parent, at, **frame)
        self.child = child if isinstance(child, Marker) else Marker(child, None, **frame)


def _orientation(marker: Marker) -> dict[str, Any]:
    """The arguments that turn another marker as this one is turned."""
    if marker.quaternion is not None:
        return {"quaternion": marker.quaternion, "angle": marker.angle}
    axis = marker.named_axis if marker.axis is None else marker.axis
    return {"axis": axis, "angle": marker.angle}
