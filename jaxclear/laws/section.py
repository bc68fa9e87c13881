"""Cross-sections of beams: what bends, twists and stretches how stiffly, and how heavy it is.

The axis of the beam is x; y and z are the principal axes of the section through its centroid.
"""

import math
from abc import abstractmethod
from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.ground.numerics import safe_sqrt
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.laws.law import check_increasing
from jaxclear.laws.material import Material

__all__ = ["AbstractSection", "AbstractShape", "Circle", "Properties", "Rectangle", "Tube"]
__getattr__, __dir__ = nothing_else("jaxclear.section", __all__)


class Rigidity(NamedTuple):
    """Stiffness of a section: bending about z and about y and twist [N m^2], stretching [N]."""

    bend_z: Scalar
    bend_y: Scalar
    twist: Scalar
    stretch: Scalar


class AbstractSection(AbstractQuantified):
    """The cross-section of a beam."""

    @abstractmethod
    def rigidity(self, material: Material | None) -> Rigidity:
        """Its stiffness.

        Args:
            material: the material; None where the stiffness is given.
        """

    @abstractmethod
    def inertia(self, density: Scalar | None) -> tuple[Scalar, Scalar, Scalar]:
        """Mass [kg/m] and moments of inertia about y and z [kg m] of a unit of length.

        Args:
            density: [kg/m^3]; None where the mass is given.
        """

    @abstractmethod
    def outer_strain(self, about_z: Any, about_y: Any) -> Any:
        """Largest strain of bending [-], None where the shape is not given.

        Args:
            about_z: curvature about z [1/m].
            about_y: curvature about y [1/m].
        """


class AbstractShape(AbstractSection):
    """A section given by its shape."""

    @abstractmethod
    def areas(self) -> tuple[Scalar, Scalar, Scalar, Scalar]:
        """Area [m^2], second moments of area about y and z [m^4], torsion constant [m^4]."""

    def rigidity(self, material: Material | None) -> Rigidity:
        assert material is not None  # a Beam has checked it
        modulus = material.young_modulus
        area, about_y, about_z, torsion = self.areas()
        shear = modulus / (2 * (1 + material.poisson_ratio))
        return Rigidity(modulus * about_z, modulus * about_y, shear * torsion, modulus * area)

    def inertia(self, density: Scalar | None) -> tuple[Scalar, Scalar, Scalar]:
        area, about_y, about_z, _ = self.areas()
        return density * area, density * about_y, density * about_z


class Circle(AbstractShape):
    """A full circle.

    Args:
        diameter: [m], > 0.
    """

    diameter: Scalar = quantity(unit="m", meaning="diameter", above=0)

    def areas(self):
        second = math.pi * self.diameter**4 / 64
        return math.pi * self.diameter**2 / 4, second, second, 2 * second

    def outer_strain(self, about_z, about_y):
        return 0.5 * self.diameter * safe_sqrt(about_z**2 + about_y**2)


class Tube(AbstractShape):
    """A circular tube.

    Args:
        inner_diameter: [m], > 0 and below the outer one.
        outer_diameter: [m], > 0.
    """

    inner_diameter: Scalar = quantity(unit="m", meaning="inner diameter", above=0)
    outer_diameter: Scalar = quantity(unit="m", meaning="outer diameter", above=0)

    def __check_init__(self):
        check_increasing(self, "inner_diameter", "outer_diameter")

    def areas(self):
        second = math.pi * (self.outer_diameter**4 - self.inner_diameter**4) / 64
        area = math.pi * (self.outer_diameter**2 - self.inner_diameter**2) / 4
        return area, second, second, 2 * second

    def outer_strain(self, about_z, about_y):
        return 0.5 * self.outer_diameter * safe_sqrt(about_z**2 + about_y**2)


class Rectangle(AbstractShape):
    """A rectangle.

    Args:
        width: along z [m], > 0.
        height: along y [m], in the plane of bending of a planar beam, > 0.

    Source: of the torsion constant, Young, Budynas & Sadegh 2012, Roark's Formulas for Stress and
    Strain, 8th ed., table 10.7.
    """

    width: Scalar = quantity(unit="m", meaning="width, along z", above=0)
    height: Scalar = quantity(unit="m", meaning="height, along y", above=0)

    def areas(self):
        width, height = self.width, self.height
        short, long = jnp.minimum(width, height), jnp.maximum(width, height)
        slender = short / long
        torsion = long * short**3 * (1 / 3 - 0.21 * slender * (1 - slender**4 / 12))
        return width * height, height * width**3 / 12, width * height**3 / 12, torsion

    def outer_strain(self, about_z, about_y):
        return 0.5 * (self.height * abs(about_z) + self.width * abs(about_y))


class Properties(AbstractSection):
    """A section given by its stiffness and mass, as tables of papers do; without outer fibres, and
    as thin as a line where it turns.

    Args:
        EI: bending stiffness about z [N m^2], > 0.
        mass_per_length: [kg/m], > 0.
        EI_y: bending stiffness about y [N m^2], > 0; that about z by default.
        GJ: stiffness of twist [N m^2], > 0; needed in space.
        EA: stiffness of stretching [N], > 0; needed where a beam stretches.
        turning_inertia: polar moment of inertia of a unit of length about x [kg m], > 0; needed
            in space.
    """

    EI: Scalar = quantity(unit="N m^2", meaning="bending stiffness about z", above=0)
    mass_per_length: Scalar = quantity(unit="kg/m", meaning="mass of a unit of length", above=0)
    EI_y: Scalar | None = quantity(None, "N m^2", "bending stiffness about y", above=0)
    GJ: Scalar | None = quantity(None, "N m^2", "stiffness of twist", above=0)
    EA: Scalar | None = quantity(None, "N", "stiffness of stretching", above=0)
    turning_inertia: Scalar | None = quantity(
        None, "kg m", "polar moment of inertia of a unit of length", above=0
    )

    def rigidity(self, material):
        return Rigidity(self.EI, self.EI if self.EI_y is None else self.EI_y, self.GJ, self.EA)

    def inertia(self, density):
        half = 0.0 if self.turning_inertia is None else self.turning_inertia / 2
        return self.mass_per_length, half, half

    def outer_strain(self, about_z, about_y):
        return None
