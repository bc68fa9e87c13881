"""Mean, deviation, quantile and share of values whose weights add up to 1.

Weights may be negative: a large sample of a surface, plus what few runs differ from it, is one such
sample, and its mean is that of a control variate. All are differentiable in the values.
"""

import jax.numpy as jnp
from jax.scipy.special import ndtr
from jaxtyping import Array, Float

from jaxclear.ground.numerics import safe_sqrt
from jaxclear.ground.quantity import Scalar

__all__ = ["deviation", "mean", "quantile", "share_above"]

# A quantile is a mean over values whose shares lie within so much of the one asked for, as a part
# of it: without it, it would jump from one sample to the next as a design changes. For a normal
# response the bias is below 5e-5 of the quantile at 3 standard deviations.
SMOOTHING = 0.03

Values = Float[Array, " samples"]


def mean(values: Values, weights: Values) -> Scalar:
    """Weighted mean."""
    return jnp.sum(weights * values)


def deviation(values: Values, weights: Values) -> Scalar:
    """Weighted standard deviation; 0 where negative weights leave no variance."""
    away = values - mean(values, weights)
    return safe_sqrt(jnp.maximum(jnp.sum(weights * away**2), 0.0))


def quantile(values: Values, weights: Values, share: Scalar) -> Scalar:
    """Value that a `share` of the population exceeds [1]."""
    order = jnp.argsort(-values)
    above = jnp.concatenate([jnp.zeros(1), jnp.cumsum(weights[order])])
    width = SMOOTHING * jnp.minimum(share, 1.0 - share)
    kernel = jnp.diff(ndtr((above - share) / width))
    return jnp.sum(kernel * values[order]) / jnp.sum(kernel)


def share_above(values: Values, weights: Values, threshold: Scalar) -> Scalar:
    """Share of the population above a threshold."""
    return jnp.sum(jnp.where(values > threshold, weights, 0.0))
