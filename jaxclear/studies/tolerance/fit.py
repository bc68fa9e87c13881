"""Fits: a hole and a shaft by their class, how parts scatter between the limits, and what that
makes of a joint with clearance.

Limits in a text are those of a drawing, in millimetres; all numbers are in SI units.
"""

import re
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_name, expect
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.ground.wording import described
from jaxclear.studies.distribution import (
    AbstractDistribution,
    Independent,
    Normal,
    TruncatedNormal,
    Uniform,
)
from jaxclear.studies.tolerance import iso286
from jaxclear.studies.variable import AbstractMechanismVariable

MILLI, MICRO = 1e-3, 1e-6
FIT = re.compile(r"\s*[øØ⌀]?\s*(\d+(?:\.\d*)?)\s*([A-Z]+\d+)\s*/\s*([a-z]+\d+)\s*")
KINDS = ("inspected", "normal", "uniform")
HOLE, SHAFT = "hole", "shaft"


class Capability(AbstractQuantified):
    """How parts scatter between the limits of a size (`jaxclear.process`).

    Args:
        cp: width of the limits over six standard deviations [1], > 0; None (default) for 1.
        cpk: distance of the mean from the nearer limit over three standard deviations [1], > 0 and
            at most `cp`: the mean lies towards the limit of most material; None (default): in the
            middle.
        distribution: name of the distribution: "inspected" (normal, cut off at the limits),
            "normal", "uniform"; None (default) for "normal" where `cp` is given, else "inspected".

    Raises:
        ValueError: if there is no such distribution, or the numbers contradict each other.
    """

    cp: Scalar | None = quantity(None, "1", above=0)
    cpk: Scalar | None = quantity(None, "1", above=0)
    distribution: str | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        if self.distribution is not None:
            check_name("distribution of a process", self.distribution, KINDS)
        if self.distribution == "uniform" and (self.cp is not None or self.cpk is not None):
            raise ValueError(
                "a process is uniform and has cp or cpk; parts that fill their limits evenly have "
                "none: leave them out."
            )
        if self.cpk is not None and (self.cp is None or self.cpk > self.cp):
            raise ValueError(
                "a process has a cpk that is above its cp, or no cp; give both, cpk at most cp."
            )

    def spread(self, width: Any, towards: int) -> tuple[Any, AbstractDistribution]:
        """Shift of the mean from the middle of the limits, and the distribution about the mean.

        Args:
            width: width of the limits [m].
            towards: 1 where most material is at the upper limit, -1 where at the lower.

        Returns:
            The shift [m] and the distribution [m].
        """
        if self.distribution == "uniform":
            return 0.0, Uniform(0.5 * width)
        cp = 1.0 if self.cp is None else self.cp
        shift = 0.0 if self.cpk is None else towards * 0.5 * width * (1.0 - self.cpk / cp)
        sigma = width / (6.0 * cp)
        kind = self.distribution or ("inspected" if self.cp is None else "normal")
        if kind == "inspected" and self.cpk is not None:
            raise ValueError(
                "a process is inspected and has a cpk; parts cut off at limits that their mean is "
                'not between evenly have no such distribution: take distribution="normal".'
            )
        return shift, Normal(sigma) if kind == "normal" else TruncatedNormal(
            sigma, bound=0.5 * width
        )


class AbstractTolerance(AbstractQuantified):
    """A line of a drawing (`jaxclear.Drawing`)."""

    @property
    def specification(self) -> str:
        """What the drawing says, as a text."""
        return ""


def _without_rounding(length: float) -> float:
    """A length [m] without the rounding of its arithmetic (ISO 286 has tenths of a micrometre, and
    halves of these), zero without a sign."""
    return round(length, 8) + 0.0


class Fit(AbstractTolerance):
    """A hole and a shaft by their classes (`jaxclear.fit`).

    `hole_limits` and `shaft_limits` are lower and upper limit deviations [m], `size` the nominal
    size [m].

    Args:
        fit: nominal size [mm] and classes, such as "20 H7/g6".
        hole: how holes scatter, a `Capability`; None (default) for inspected parts.
        shaft: how shafts scatter, a `Capability`; None (default) for inspected parts.

    Raises:
        ValueError: if the text is no fit, or ISO 286 lacks a class at this size.
    """

    fit: str = eqx.field(static=True)
    hole: Capability | None = None
    shaft: Capability | None = None

    def __check_init__(self):
        size, *codes = self._read()
        for code in codes:
            iso286.limits(float(size), code)

    def _read(self) -> tuple[str, ...]:
        """Size [mm], class of the hole and of the shaft. Raises `ValueError`."""
        match = FIT.fullmatch(self.fit)
        if match is None:
            raise ValueError(
                f"{described(self.fit)} is no fit; write the size in mm, the class of the hole and "
                'that of the shaft, such as "20 H7/g6".'
            )
        return match.groups()

    def _summary(self):
        limits = self.hole_limits, self.shaft_limits
        ends = [f"{low / MICRO:+.4g} to {high / MICRO:+.4g}" for low, high in limits]
        least, largest = (end / MICRO for end in self.clearance)
        return (
            f"Fit {self.fit}: hole {ends[0]} um, shaft {ends[1]} um; clearance of the diameters "
            f"{least:.4g} to {largest:.4g} um."
        )

    @property
    def specification(self):
        return self.fit

    @property
    def size(self) -> float:
        """Nominal size [m]."""
        return MILLI * float(self._read()[0])

    @property
    def classes(self) -> tuple[str, str]:
        """Class of the hole and class of the shaft."""
        _, hole, shaft = self._read()
        return hole, shaft

    def with_classes(self, hole: str, shaft: str) -> "Fit":
        """The fit of the same size and processes with other classes.

        Args:
            hole: class of the hole, such as "H7".
            shaft: class of the shaft, such as "g6".

        Returns:
            The `Fit`.
        """
        return Fit(f"{self._read()[0]} {hole}/{shaft}", self.hole, self.shaft)

    def limits(self, side: int) -> tuple[float, float]:
        """Lower and upper limit deviation of a part [m].

        Args:
            side: index of the part, 0 for the hole, 1 for the shaft.

        Returns:
            The two.
        """
        low, high = iso286.limits(float(self._read()[0]), self.classes[side])
        return _without_rounding(MICRO * low), _without_rounding(MICRO * high)

    @property
    def hole_limits(self) -> tuple[float, float]:
        """Lower and upper limit deviation of the hole [m]."""
        return self.limits(0)

    @property
    def shaft_limits(self) -> tuple[float, float]:
        """Lower and upper limit deviation of the shaft [m]."""
        return self.limits(1)

    @property
    def clearance(self) -> tuple[float, float]:
        """Least and largest difference of the diameters [m]; below 0 it is an interference."""
        hole, shaft = self.hole_limits, self.shaft_limits
        return _without_rounding(hole[0] - shaft[1]), _without_rounding(hole[1] - shaft[0])

    def check_clearance(self, joint: str) -> None:
        """Raises `ValueError` where parts may interfere.

        Args:
            joint: name of the joint.
        """
        least, largest = self.clearance
        if least < 0:
            what = "a press fit" if largest <= 0 else "a transition fit"
            raise ValueError(
                f'the fit {self.fit} of joint "{joint}" is {what}: its clearance is '
                f"{least / MICRO:.4g} to {largest / MICRO:.4g} um, an interference of up to "
                f"{-least / MICRO:.4g} um. A joint with clearance takes a fit that always leaves "
                "play; parts that are pressed together are an ideal joint, or one body."
            )

    def sizes(self, joint: str) -> "FitSizes":
        """The variable of a joint with this fit.

        Args:
            joint: name of the joint.

        Returns:
            The variable.
        """
        means, laws = [], []
        sides = (self.hole, self.hole_limits, -1), (self.shaft, self.shaft_limits, 1)
        for process, (low, high), towards in sides:
            shift, law = (process or Capability()).spread(high - low, towards)
            means.append(self.size + 0.5 * (low + high) + shift)
            laws.append(law)
        return FitSizes(joint, jnp.stack(list(map(jnp.asarray, means))), laws, self)


class FitSizes(AbstractMechanismVariable):
    """Diameters of the hole and the shaft of a joint with clearance, two numbers of one variable.

    Args:
        joint: name of the joint.
        means: mean diameter of hole and shaft [m], 2 numbers.
        laws: distribution of either about its mean, a sequence of 2.
        fit: the `Fit` that has them.
    """

    joint: str = eqx.field(static=True)
    means: Array
    distribution: Independent
    fit: Fit

    def __init__(self, joint: str, means: Any, laws: Any, fit: Fit):
        self.joint, self.means, self.fit = joint, jnp.asarray(means), fit
        self.distribution = Independent((HOLE, SHAFT), laws)

    def nominal_in(self, subject):
        return self.means

    def unit_in(self, subject):
        return "m"

    def put(self, name, subject, value):
        where = lambda tree: tree.connections[self.joint].joint
        return eqx.tree_at(where, subject, where(subject).with_diameters(*value))

    def leaves(self, mechanism):
        joint = mechanism.connections[self.joint].joint
        other = joint.with_diameters(*joint.diameters())
        pairs = zip(*map(jax.tree.leaves, (joint, other)), strict=True)
        return [old for old, new in pairs if old is not new]

    def check(self, name, mechanism):
        check_name("joint", self.joint, mechanism.topology.clearances, " with clearance")
        try:
            mechanism.connections[self.joint].joint.diameters()
        except ValueError as error:
            raise ValueError(f'joint "{self.joint}" {error}') from None

    def identity(self, name, subject):
        return {f'fit of "{name}"': (self.joint, self.means)}


@answering
def fit(text: str, *, hole: Capability | None = None, shaft: Capability | None = None) -> Fit:
    """A hole and a shaft by their classes of ISO 286, sizes up to 500 mm.

    A line of a `jaxclear.Drawing` under the name of a joint with clearance. Fits that interfere
    have limits too, but no joint takes them.

    Args:
        text: nominal size [mm] and classes, such as "20 H7/g6".
        hole: how holes scatter, as `jaxclear.process` returns it; None (default) for inspected
            parts.
        shaft: how shafts scatter; None (default) for inspected parts.

    Returns:
        The `Fit`: `hole_limits`, `shaft_limits` and `clearance` (of diameters) in m.

    Raises:
        ValueError: if the text is no fit, or ISO 286 lacks a class at this size.

    Source: ISO 286-1:2010 (tables and their sources: files of the package).
    """
    expect(text, str, "a fit", 'a text, such as "20 H7/g6"')
    return Fit(text, hole, shaft)


@answering
def process(cp: Any = None, *, cpk: Any = None, distribution: str | None = None) -> Capability:
    """How parts scatter between the limits of a size.

    Args:
        cp: width of the limits over six standard deviations [1], > 0; None (default) for 1.
        cpk: distance of the mean from the nearer limit over three standard deviations [1], > 0 and
            at most `cp`: the mean lies towards the limit of most material; None (default): in the
            middle.
        distribution: name of the distribution: "inspected" (normal, cut off at the limits),
            "normal", "uniform"; None (default) for "normal" where `cp` is given, else "inspected".

    Returns:
        The `Capability`.

    Raises:
        ValueError: if there is no such distribution, or the numbers contradict each other.
    """
    return Capability(cp, cpk, distribution)
