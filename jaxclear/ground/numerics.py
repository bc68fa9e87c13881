"""Elementary functions whose value and derivatives stay finite everywhere.

Each guards one singularity of the textbook formula by evaluating the formula at a harmless point
wherever the guard holds ("double where"), because a plain `where` still multiplies the untaken
branch's infinite derivative by zero. In a batch XLA may evaluate an argument twice with different
rounding, so that the two `where` disagree: what the formula gives at the harmless point then is the
answer, and must itself be harmless (nearly zero, never 1). All take and return arrays of one shape,
are smooth under `vmap`, and define their derivative at the guarded point.

Where a function has a rule of its own for its derivative, its formula has the same one: a second
derivative through `jax.lax.scan`, the first of both in reverse mode, goes through the formula,
because JAX forgets the rules of what is known there.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground import array_functions as xp
from jaxclear.ground.argument_errors import nothing_else

__all__ = [
    "inverse_entropy",
    "positive_part",
    "power",
    "rounded_norm",
    "safe_divide",
    "safe_sqrt",
    "smooth_sign",
    "smooth_step",
]
__getattr__, __dir__ = nothing_else("jaxclear.numerics", __all__)

# Sums of squares below this count as zero. Far below the square of any length, speed or force of a
# mechanism, and far enough from the smallest float64 that second derivatives (x^-3/2, and squares
# of x in denominators) neither overflow nor underflow: a contact's normal is a first derivative
# already, and is differentiated once more by whoever varies it.
TINY_SQUARE = 1e-100
# By so much one of two numbers is enlarged before they are compared, where being equal is likely
# (symmetric mechanisms, powers of two) and either answer will do: asked twice with different
# rounding, the answer is then the same.
OFF_THE_TIES = 1 + 2.0**-20


def safe_sqrt(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """sqrt(max(x, 0)); the derivative at and below zero is 0 instead of infinite.

    Args:
        x: radicand, any shape; values below 1e-100 count as zero.

    Returns:
        The root, of the same shape.
    """
    positive = x > TINY_SQUARE
    return xp.where(positive, xp.sqrt(xp.where(positive, x, TINY_SQUARE)), 0.0)


def safe_divide(numerator, denominator):
    """numerator / denominator, and 0 with zero derivative where the denominator is exactly 0.

    Args:
        numerator: dividend, an array of any shape.
        denominator: divisor, an array of the same shape.

    Returns:
        The quotient.
    """
    regular = denominator != 0
    return xp.where(regular, numerator / xp.where(regular, denominator, jnp.inf), 0.0)


def direction_angle(x: Float[Array, "..."], y: Float[Array, "..."]) -> Float[Array, "..."]:
    """atan2(y, x), and 0 with zero derivative at the origin.

    Args:
        x: first coordinate, any shape.
        y: second coordinate, of the same shape.

    Returns:
        The angle [rad], from -pi to pi.
    """
    somewhere = x * x + y * y > TINY_SQUARE
    return jnp.where(
        somewhere, jnp.arctan2(jnp.where(somewhere, y, 0.0), jnp.where(somewhere, x, 1.0)), 0.0
    )


def power(base: Float[Array, "..."], exponent: Float[Array, "..."] | None) -> Float[Array, "..."]:
    """max(base, 0) ** exponent; value and first derivative are 0 at and below zero.

    Args:
        base: base, an array of any shape.
        exponent: exponent [1], > 1; None for Hertz's 3/2, evaluated as x sqrt(x), which is several
            times cheaper.

    Returns:
        The power, of the shape of `base`.
    """
    positive = base > 0
    inside = jnp.where(positive, base, TINY_SQUARE)
    raised = inside * jnp.sqrt(inside) if exponent is None else inside**exponent
    return jnp.where(positive, raised, 0.0)


def positive_part(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """max(x, 0), with derivative 0 at 0.

    Args:
        x: an array of any shape.

    Returns:
        An array of the same shape.
    """
    return jnp.where(x > 0, x, 0.0)


def smooth_step(x: Float[Array, "..."], start, stop, low=0.0, high=1.0) -> Float[Array, "..."]:
    """Cubic step, constant outside an interval (the STEP function of Adams).

    low + (high - low) s^2 (3 - 2 s) with s = (x - start) / (stop - start); it is continuous with
    its first derivative.

    Args:
        x: argument, an array of any shape.
        start: value of `x` where the step begins.
        stop: value of `x` where it ends, different from `start`.
        low: value before it; 0 by default.
        high: value behind it; 1 by default.

    Returns:
        The value, of the shape of `x`.
    """
    share = jnp.clip((x - start) / (stop - start), 0.0, 1.0)
    return low + (high - low) * share * share * (3.0 - 2.0 * share)


def smooth_sign(x: Float[Array, "..."], width) -> Float[Array, "..."]:
    """tanh(x / width): a sign function that passes through zero within a few widths.

    Args:
        x: argument, an array of any shape.
        width: width of the transition, in the unit of `x`, > 0.

    Returns:
        The value [1], between -1 and 1.
    """
    return jnp.tanh(x / width)


def rounded_norm(*components, width) -> Float[Array, "..."]:
    """sqrt(sum of squares + width^2): exceeds the norm by at most `width`, smooth at zero.

    Args:
        components: components of a vector, arrays of one shape.
        width: radius of the rounding, in the unit of the components, > 0.

    Returns:
        The norm, of the shape of a component.
    """
    return jnp.sqrt(sum(component * component for component in components) + width * width)


# Arc sine less its argument, over the argument's cube, for squares of it up to 1/4: a quotient of
# polynomials of Sun's fdlibm (e_asin.c), right to 2^-58.
SINE_TOP = (
    3.47933107596021167570e-05,
    7.91534994289814532176e-04,
    -4.00555345006794114027e-02,
    2.01212532134862925881e-01,
    -3.25565818622400915405e-01,
    1.66666666666666657415e-01,
)
SINE_BOTTOM = (
    7.70381505559019352791e-02,
    -6.88283971605453293030e-01,
    2.02094576023350569471e00,
    -2.40339491173441421878e00,
    1.0,
)


@jax.custom_jvp
def arc_sine(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """arcsin(x) for x from -1 to 1; the derivative at both ends is 0 instead of infinite.

    It consists of arithmetic, which XLA vectorises; for `jnp.arcsin` it calls the C library for
    each number.

    Args:
        x: sine [1], from -1 to 1, any shape.

    Returns:
        The angle [rad], from -pi/2 to pi/2.

    Source: The quotient of polynomials of Sun's fdlibm (e_asin.c).
    """
    size = jnp.abs(x)
    # Above 1/2 that of half the angle that is left to a right one.
    steep = size > 0.5
    square = jnp.where(steep, 0.5 * (1.0 - size), x * x)
    sine = jnp.where(steep, safe_sqrt(square), x)
    rest = _horner(square, SINE_TOP) / _horner(square, SINE_BOTTOM)
    angle = sine + sine * square * rest
    return jnp.where(steep, jnp.sign(x) * (0.5 * jnp.pi - 2.0 * angle), angle)


@arc_sine.defjvp
def _arc_sine_jvp(primals, tangents):
    (x,), (x_dot,) = primals, tangents
    return arc_sine(x), safe_divide(x_dot, safe_sqrt(1.0 - x * x))


def _horner(x: Float[Array, "..."], coefficients: tuple[float, ...]) -> Float[Array, "..."]:
    """The polynomial in x with these coefficients, the highest power's first."""
    total = jnp.full_like(x, coefficients[0])
    for coefficient in coefficients[1:]:
        total = total * x + coefficient
    return total


# Newton steps that bring the function below from its asymptotic start to rounding for x <= 0.3
# (measured against scipy's Lambert function); towards the double root at x = 1/e they fall short,
# 3e-12 at 0.35.
LOGARITHM_STEPS = 5
SMALLEST_LOAD = 1e-300


@jax.custom_jvp
def inverse_entropy(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """The w < 1/e that solves -w ln w = x for 0 < x < 1/e; 0 for x <= 0.

    It is minus x over the lower branch of Lambert's function. Newton's method solves p - ln p = -ln
    x with p = -ln w; derivatives follow from the implicit function theorem. The accuracy is that of
    rounding for x <= 0.3, and 3e-12 at 0.35.

    Args:
        x: value of -w ln w [1], below 1/e, any shape.

    Returns:
        w [1], of the same shape.
    """
    positive = x > SMALLEST_LOAD
    inside = jnp.where(positive, x, SMALLEST_LOAD)
    target = -jnp.log(inside)
    p = target + jnp.log(target)
    for _ in range(LOGARITHM_STEPS):
        p = p - (p - jnp.log(p) - target) * p / (p - 1)
    return jnp.where(positive, inside / p, 0.0)


@inverse_entropy.defjvp
def _inverse_entropy_jvp(primals, tangents):
    (x,), (x_dot,) = primals, tangents
    w = inverse_entropy(x)
    positive = w > 0
    slope = jnp.where(positive, 1 / (-jnp.log(jnp.where(positive, w, SMALLEST_LOAD)) - 1), 0.0)
    return w, slope * x_dot
