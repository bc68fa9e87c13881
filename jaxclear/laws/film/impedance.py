r"""Films of any length as a short Fourier sum in their natural plane.

The full film damps along and across the line of centres alone, by :math:`c_r` and :math:`c_t`:
those of a short and of a long bearing in series. In :math:`(\sqrt{c_r} v_r, \sqrt{c_t} v_t) =
\varrho (\cos\varphi, \sin\varphi)` the film that cavitates is :math:`\varrho` times few harmonics
of :math:`\varphi`, whose coefficients are Chebyshev polynomials of :math:`t = \sqrt{1 -
\varepsilon^2}` and :math:`z = \lambda/(\lambda + 2.5 t)`. Even harmonics carry a factor
:math:`\varepsilon`, so that the centre is regular; dissipation is floored at 0, so that no film
gives energy. The numbers are fitted to solutions of Reynolds' equation in two dimensions
(`benchmarks/film_coefficients.py`).
"""

import csv
import functools
from pathlib import Path
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar
from jaxclear.laws.film.base import AbstractFilm, thinnest_field, viscosity_field
from jaxclear.laws.stiffness import Fitted

# In z = slenderness / (slenderness + OFFSET t).
OFFSET = 2.5
# Ratios of length to diameter that the fit covers, with what is within rounding of them.
FITTED = (0.1 * (1 - 1e-9), 4.0 * (1 + 1e-9))
# Width over which dissipation is rounded at 0, a share of that of a film that closes.
ROUNDING = 2e-4


@functools.cache
def read_harmonics(film: str) -> tuple[tuple[np.ndarray, tuple], ...]:
    """Coefficients of a film, those of one degree together: an array (m, t, z), and of each of its
    m rows ("closing", "across" or "opening", harmonic)."""
    by_size: dict[int, tuple[list, list]] = {}
    with Path(__file__).with_name("coefficients.csv").open() as file:
        for name, part, harmonic, *numbers in csv.reader(file):
            if name == film:
                values, keys = by_size.setdefault(len(numbers), ([], []))
                values.append(np.array(numbers, float))
                keys.append((part, int(harmonic)))
    return tuple(
        (np.stack(values).reshape(len(keys), round(size**0.5), -1), tuple(keys))
        for size, (values, keys) in by_size.items()
    )


def full_film_scales(e: Any, t: Any, slenderness: Any) -> tuple[Any, Any]:
    """Damping of the full film along and across the line of centres [1].

    Args:
        e: eccentricity ratio [1], 0 to 1.
        t: sqrt(1 - e^2).
        slenderness: length over diameter of the bearing [1].
    """
    short, long = 2 / 3 * jnp.pi * slenderness**3, 2 * jnp.pi * slenderness
    t3 = t * t * t
    radial = short * (1 + 2 * e * e) / (t3 * t * t), long / t3
    beside = short / t3, 2 * long / ((2 + e * e) * t)
    return tuple(a * b / (a + b) for a, b in (radial, beside))


def chebyshev(x: Any, count: int) -> Any:
    """The first Chebyshev polynomials at 2 x - 1."""
    x = 2 * x - 1
    values = [jnp.ones_like(x), x]
    while len(values) < count:
        values.append(2 * x * values[-1] - values[-2])
    return jnp.stack(values)


def parity_weight(e: Any, harmonic: int) -> Any:
    """By what a harmonic vanishes at the centre."""
    return e if harmonic % 2 == 0 else 1.0 if harmonic == 1 else e * e


def film_force(film: str, e: Any, closing: Any, across: Any, slenderness: Any) -> tuple[Any, Any]:
    """Dimensionless force of a cavitated film against closing and across.

    Args:
        film: name of the fit's table, such as "reynolds".
        e: eccentricity ratio [1], 0 to 1.
        closing, across: dimensionless speeds of the journal along and across the line of centres.
        slenderness: length over diameter of the bearing [1].
    """
    tables, t = read_harmonics(film), jnp.sqrt((1 - e) * (1 + e))
    count = max(values.shape[1] for values, _ in tables)
    in_t = chebyshev(t, count)
    in_z = chebyshev(slenderness / (slenderness + OFFSET * t), count)
    terms: dict[tuple[str, int], Any] = {}
    for values, keys in tables:
        m, size, _ = values.shape
        sums = (values.reshape(m * size, size) @ in_z[:size]).reshape(m, size) @ in_t[:size]
        terms |= {key: sums[i] for i, key in enumerate(keys)}
    scales = [jnp.sqrt(scale) for scale in full_film_scales(e, t, slenderness)]
    x, y = scales[0] * closing, scales[1] * across
    rho = safe_sqrt(x * x + y * y)
    c, s = safe_divide(x, rho), safe_divide(y, rho)
    first, radial, beside, opened = terms["closing", 1], 0.0, 0.0, 0.0
    cosine, sine = [1.0, c], [0.0, s]
    for _ in range(2, 1 + max(harmonic for _, harmonic in terms)):
        cosine.append(2 * c * cosine[-1] - cosine[-2])
        sine.append(2 * c * sine[-1] - sine[-2])
    for (part, k), term in terms.items():
        if part == "closing":
            weight = parity_weight(e, k) * term
            radial, opened = radial + weight * cosine[k], opened + (-1) ** k * weight
        elif part == "across":
            weight = first + e * e * term if k == 1 else parity_weight(e, k) * term
            beside = beside + weight * sine[k]
    # What is left where the film opens fixes the mean: t^3 of what closes at the centre.
    radial = radial - opened - t * t * t * (first + e * terms["opening", 0])
    power = radial * c + beside * s
    missing = 0.5 * (jnp.sqrt(power * power + ROUNDING * ROUNDING) - power)
    return (
        rho * scales[0] * (radial + missing * c),
        rho * scales[1] * (beside + missing * s),
    )


class Reynolds(AbstractFilm):
    r"""Film with Reynolds' boundary: pressure and its slope vanish where the film ends (Swift and
    Stieber), the steady limit of mass-conserving cavitation.

    The usual choice. Within 1 % of Reynolds' equation for eccentricity ratios up to 0.99 and L/D
    0.1 to 4, for any mix of squeeze and wedge; it never gives energy. Film all round: no grooves,
    no feed pressure.

    Args:
        viscosity: dynamic viscosity [Pa s], > 0; a number or a `Vogel`.
        thinnest: least film thickness over clearance [1], >= 0.0005 and < 0.5; below it it is taken
            as this.

    Source: Booker 1965, J. Basic Eng. 87, 168, doi:10.1115/1.3650461; Childs, Moes & van Leeuwen
    1977, J. Lubr. Technol. 99, 198, doi:10.1115/1.3453016; numbers of its own.
    """

    slenderness: ClassVar = FITTED
    viscosity: Fitted = viscosity_field()
    thinnest: Scalar = thinnest_field()

    def force(self, eccentricity_ratio, closing, across, slenderness):
        return film_force("reynolds", eccentricity_ratio, closing, across, slenderness)


class HalfFilm(AbstractFilm):
    r"""The full film's pressure where it is positive (Gümbel's, half Sommerfeld), of any length.

    For comparison with tables and programs that take this boundary; it loses oil where the film
    ends. Within 1 % for the range of `Reynolds`, from which it differs by 4 % in the median.

    Args:
        viscosity: dynamic viscosity [Pa s], > 0; a number or a `Vogel`.
        thinnest: least film thickness over clearance [1], >= 0.0005 and < 0.5; below it it is taken
            as this.

    Source: Gümbel 1921, Mon. Blätt. Berlin. Bez. VDI 5; Childs, Moes & van Leeuwen 1977, J. Lubr.
    Technol. 99, 198, doi:10.1115/1.3453016; numbers of its own.
    """

    slenderness: ClassVar = FITTED
    viscosity: Fitted = viscosity_field()
    thinnest: Scalar = thinnest_field()

    def force(self, eccentricity_ratio, closing, across, slenderness):
        return film_force("half", eccentricity_ratio, closing, across, slenderness)
