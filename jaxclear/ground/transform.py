"""Homogeneous transformation matrices T in SE(3), and the twists between them.

T (4, 4) maps a child's coordinates to the parent's, x_parent = R x_child + p. Twists V [m, rad] are
linear then angular, in body axes. For dense kinematics that are mapped over a run: products of
matrices compile several times faster than those of jaxlie's quaternions, and than those of the
scalars of `pose`, which keep structural zeros and serve the equations of motion. jaxlie gives the
exponential and the logarithm, whose derivatives it keeps finite, and appears nowhere else here.
Source: Lynch & Park 2017, Modern Robotics, doi:10.1017/9781316661239, chapter 3.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float

from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import Pose

__all__ = [
    "Transform",
    "TwistVector",
    "adjoint_of_inverse",
    "exponentials",
    "from_pose",
    "inverse",
    "logarithms",
    "transform",
]

Transform = Float[Array, "4 4"]
TwistVector = Float[Array, " 6"]


def transform(rotation: Float[Array, "3 3"], translation: Float[Array, " 3"]) -> Transform:
    """T of a rotation R and a translation p [m]."""
    upper = jnp.concatenate([rotation, translation[:, None]], axis=1)
    return jnp.concatenate([upper, jnp.array([[0.0, 0.0, 0.0, 1.0]])])


def from_pose(pose: Pose) -> Transform:
    """T of a pose on sparse scalars."""
    return transform(
        jnp.stack([sp.stack(row) for row in pose.rotation]), sp.stack(pose.translation)
    )


def inverse(pose: Transform) -> Transform:
    """T^-1: R^T and -R^T p."""
    turned = pose[:3, :3].T
    return transform(turned, -turned @ pose[:3, 3])


def exponentials(twists: Sequence[TwistVector]) -> list[Transform]:
    """exp [V] of each twist; all at once, because this function and the next are slow to
    compile."""
    return list(jaxlie.SE3.exp(jnp.stack(twists)).as_matrix()) if twists else []


def logarithms(poses: Sequence[Transform]) -> list[TwistVector]:
    """The twist V with exp [V] = T of each transformation."""
    return list(jaxlie.SE3.from_matrix(jnp.stack(poses)).log()) if poses else []


def adjoint_of_inverse(pose: Transform, twist: TwistVector) -> TwistVector:
    """[Ad_{T^-1}] V: a twist in the parent's axes, seen by the child that is rigidly joined to
    it: R^T (v + w x p), R^T w.
    """
    linear, angular = twist[:3], twist[3:]
    turned = pose[:3, :3].T
    return jnp.concatenate([turned @ (linear + jnp.cross(angular, pose[:3, 3])), turned @ angular])
