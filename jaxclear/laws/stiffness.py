"""What a law's parameter is when the joint's own geometry decides it.

A law sees numbers only. Where a number follows from the radii (a Hertz stiffness, a clearance), its
field holds a fit instead, and `fitted(law, shape)` replaces every fit by its value, once, outside
the time loop; derivatives with respect to the radii pass through. Clearance c = outer radius -
inner radius > 0.
"""

from abc import abstractmethod
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp

from jaxclear.ground.argument_errors import defined_names, nothing_else
from jaxclear.ground.arguments import expect
from jaxclear.ground.numerics import safe_sqrt
from jaxclear.ground.quantity import AbstractQuantified, Scalar, as_number, concrete, quantity
from jaxclear.laws.material import Material, combined_modulus

# Hertz: F = 4/3 E* sqrt(R) delta^(3/2) for two spheres (Johnson 1985, eq. 4.23).
HERTZ_SPHERE = 4 / 3


class Shape(AbstractQuantified):
    """Geometry of a journal in a bearing or a ball in a socket.

    Args:
        inner_radius: radius of the journal or ball [m], > 0.
        outer_radius: radius of the bearing's hole or of the socket [m], > 0.
        length: length of the contact along the axis [m], > 0; None: a spherical pair.

    Raises:
        ValueError: if the inner radius is not below the outer one.
    """

    inner_radius: Scalar = quantity(unit="m", above=0)
    outer_radius: Scalar = quantity(unit="m", above=0)
    length: Scalar | None = quantity(None, "m", above=0)

    def __check_init__(self):
        inner, outer = concrete(self.inner_radius), concrete(self.outer_radius)
        if inner is not None and outer is not None and inner >= outer:
            raise ValueError(
                f"a journal of radius {inner:g} m does not fit a bearing of radius {outer:g} m: "
                "the outer radius must be the larger one."
            )

    @property
    def clearance(self) -> Scalar:
        """Radial clearance c [m]."""
        return self.outer_radius - self.inner_radius


class AbstractFit(AbstractQuantified):
    """A number that the pair's geometry decides."""

    @abstractmethod
    def value(self, shape: Shape) -> Scalar:
        """The number for a pair of surfaces.

        Args:
            shape: radii and length of the pair, a `Shape`.

        Returns:
            the number, in the unit of the field that holds the fit.
        """


# What a field of a law holds: a number, or before `fitted` the fit that gives it.
if TYPE_CHECKING:
    Fitted = Any
else:
    Fitted = Scalar | AbstractFit


class HertzStiffness(AbstractFit):
    r"""Stiffness of a ball in a socket [N/m^1.5], :math:`K = \frac{4}{3\pi(h_i + h_j)}
    \sqrt{R_i R_j/(R_j - R_i)}`.

    :math:`h = (1 - \nu^2)/(\pi E)`, so :math:`\pi(h_i + h_j) = 1/E^*`. Range: contact area small
    beside the radii, which an overlap near the clearance violates; for a cylinder it is customary
    but not Hertz (prefer the laws of `contact.cylinder`).

    Args:
        inner: material of the journal or ball.
        outer: material of the bearing or socket.

    Source: Hertz 1882, J. reine angew. Math. 92, 156, doi:10.1515/crll.1882.92.156; in this form
    Lankarani & Nikravesh 1990, J. Mech. Des. 112, 369, doi:10.1115/1.2912617. Wan, Liu, Ma & Tong,
    "Investigation on Dynamic Interaction of Multiple Clearance Joints for Flap Actuation System",
    eq. 7, print 1 - nu for 1 - nu^2.
    """

    inner: Material
    outer: Material

    def value(self, shape: Shape) -> Scalar:
        effective_radius = shape.inner_radius * shape.outer_radius / shape.clearance
        return HERTZ_SPHERE * combined_modulus(self.inner, self.outer) * safe_sqrt(effective_radius)


class CombinedModulus(AbstractFit):
    """E* of the two materials [Pa]; see `material.combined_modulus`.

    Args:
        inner: material of the journal or ball.
        outer: material of the bearing or socket.
    """

    inner: Material
    outer: Material

    def value(self, shape: Shape) -> Scalar:
        return combined_modulus(self.inner, self.outer)


class ClearanceOf(AbstractFit):
    """The pair's radial clearance c = R_outer - R_inner [m]."""

    def value(self, shape: Shape) -> Scalar:
        return shape.clearance


class InnerRadiusOf(AbstractFit):
    """The journal's or ball's radius [m]."""

    def value(self, shape: Shape) -> Scalar:
        return shape.inner_radius


class OuterRadiusOf(AbstractFit):
    """The bearing's or socket's radius [m]."""

    def value(self, shape: Shape) -> Scalar:
        return shape.outer_radius


class LengthOf(AbstractFit):
    """The contact's length along the axis [m]; `ValueError` for a pair that has none."""

    def value(self, shape: Shape) -> Scalar:
        if shape.length is None:
            raise ValueError(
                "this contact law presses along a line and needs Shape.length, but the pair has "
                "none; "
                "give the length, or take a law for a ball in a socket."
            )
        return shape.length


def fitted(law, shape: Shape):
    """Replace every fit of a law, at any depth, by its number for a shape.

    The result is differentiable in the shape.

    Args:
        law: any law (or other tree) whose fields may hold fits.
        shape: radii and length of the pair, a `Shape`.

    Returns:
        the law with numbers only.

    Raises:
        ValueError: if `shape` is no `Shape`, or lacks the length that a fit needs.
    """

    expect(shape, Shape, "the shape that a law is fitted to", "a jaxclear.stiffness.Shape")

    def settle(node):
        return jnp.asarray(as_number(node.value(shape))) if isinstance(node, AbstractFit) else node

    return jax.tree.map(settle, law, is_leaf=lambda node: isinstance(node, AbstractFit))


__all__ = defined_names(globals(), "Fitted")
__getattr__, __dir__ = nothing_else("jaxclear.stiffness", __all__)
