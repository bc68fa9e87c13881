"""Finding every law of a family, building it, and the two checks that all families share:
derivatives and units.
"""

import dataclasses
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pint
import pytest

from jaxclear.ground.quantity import numbers
from jaxclear.laws import contact
from jaxclear.laws.stiffness import Shape, fitted

UNITS = pint.UnitRegistry()
# A new set of base units, none a power of another: length, mass, time.
SCALES = {"[length]": 1e3, "[mass]": 7.0, "[time]": 0.3}
OPTIONAL_SLOTS = {"viscous": 0.01, "exponent": 1.4}


def shape():
    return Shape(9.9e-3, 10e-3, 30e-3)


def members(abstract):
    """Every concrete law of the package below `abstract`, in order of name; other tests' own laws
    are theirs to check, and a choice between laws, which studies make, is none."""
    found = set()
    for child in abstract.__subclasses__():
        found |= set(members(child))
        final = not child.__name__.startswith("Abstract")
        if final and child.__module__.startswith("jaxclear.laws."):
            found.add(child)
    return sorted(found, key=lambda law: law.__name__)


def variants(law):
    """The law with its defaults, and with each optional slot filled."""
    yield fitted(law(), shape())
    for field in dataclasses.fields(law):
        if field.name in OPTIONAL_SLOTS and field.default is None:
            yield fitted(law(**{field.name: OPTIONAL_SLOTS[field.name]}), shape())


def family(abstract):
    """(identifier, law) of every variant of every member that is no product of others, as pytest
    likes them."""
    return [
        (f"{cls.__name__}-{index}", law)
        for cls in members(abstract)
        if cls is not contact.ContactForce
        for index, law in enumerate(variants(cls))
    ]


def contact_laws():
    """(identifier, law) of every additive law, of every elastic force without loss, and of every
    dissipation factor on Hertz's force."""
    forces = family(contact.AbstractElasticForce)
    factors = family(contact.AbstractDissipation)
    return (
        family(contact.AbstractContactLaw)
        + [(name, contact.ContactForce(force)) for name, force in forces]
        + [
            (name, contact.ContactForce(contact.elastic.Hertz(), factor))
            for name, factor in factors
        ]
    )


def contact_products():
    """Every elastic force times every dissipation factor, as pytest's parameters: one runs always,
    since each force and each factor is tried alone, the rest as slow tests."""
    forces = family(contact.AbstractElasticForce)
    factors = family(contact.AbstractDissipation)
    always = {(5 % len(forces), 5 % len(factors))}
    return [
        pytest.param(
            contact.ContactForce(force, factor),
            id=f"{force_name}-x-{factor_name}",
            marks=() if (i, j) in always else pytest.mark.slow,
        )
        for i, (force_name, force) in enumerate(forces)
        for j, (factor_name, factor) in enumerate(factors)
    ]


def assert_finite(tree, what):
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        assert np.all(np.isfinite(leaf)), (
            f"{what}: not finite at {jax.tree_util.keystr(path)}: {leaf}"
        )


def assert_finite_derivatives(function, law, arguments):
    """Value, grad, jvp and vmap of grad, by the arguments and by every parameter of the law, at
    rows of arguments."""

    def value(law, row):
        return function(law, *row)

    def everything(row):
        tangent = (jax.tree.map(jnp.ones_like, law), jnp.ones_like(row))
        return (
            value(law, row),
            jax.grad(value, argnums=(0, 1))(law, row),
            jax.jvp(value, (law, row), tangent)[1],
        )

    rows = jnp.asarray(np.array(arguments, dtype=float))
    results = jax.jit(jax.vmap(everything))(rows)
    assert_finite(results, type(law).__name__)
    single = jax.jit(everything)(rows[0])
    for one, all_ in zip(jax.tree.leaves(single), jax.tree.leaves(results), strict=False):
        np.testing.assert_allclose(one, all_[0], rtol=1e-12, atol=1e-300)
    pulled = sum(
        jnp.sum(leaf, axis=tuple(range(1, leaf.ndim))) for leaf in jax.tree.leaves(results[1])
    )
    # forward and reverse mode are the same sum in another order; terms of either sign cancel to
    # rounding
    size = sum(
        jnp.sum(jnp.abs(leaf), axis=tuple(range(1, leaf.ndim)))
        for leaf in jax.tree.leaves(results[1])
    )
    assert np.all(np.abs(pulled - results[2]) <= 1e-12 * size + 1e-300)


def unit_factor(unit, exponents):
    """By how much a number of this unit grows in the new base units; field names stand for
    exponents."""
    for name, exponent in exponents.items():
        unit = re.sub(rf"\b{name}\b", str(exponent), unit)
    dimensions = UNITS.Quantity(1.0, "" if unit == "1" else unit).dimensionality
    return float(np.prod([SCALES[base] ** -power for base, power in dimensions.items()]))


def in_new_units(law):
    """The same law with every number, those of its parts included, converted by its unit."""
    named = list(numbers(law))
    exponents = {"exponent": 1.5}
    exponents |= {path.split(".")[-1]: float(leaf) for path, leaf, _ in named if "exponent" in path}
    converted = [leaf * unit_factor(meta["unit"], exponents) for _, leaf, meta in named]
    return jax.tree.unflatten(jax.tree.structure(law), converted)


def assert_unit_free(law, function, arguments, units, result_unit):
    converted = in_new_units(law)
    for row in arguments:
        scaled = [
            jnp.asarray(x * unit_factor(unit, {})) for x, unit in zip(row, units, strict=False)
        ]
        expected = function(law, *map(jnp.asarray, row)) * unit_factor(result_unit, {})
        # rounding of the unit factors, amplified by logarithms and powers
        np.testing.assert_allclose(function(converted, *scaled), expected, rtol=1e-11)


def grid(*axes):
    return np.stack(
        [axis.ravel() for axis in np.meshgrid(*map(np.asarray, axes), indexing="ij")], axis=-1
    ).astype(float)


def evaluate(function, rows):
    """The function at every row of arguments; a method of a law is compiled once per class, not
    once per call."""
    return np.asarray(_mapped(function, jnp.asarray(rows)))


@eqx.filter_jit
def _mapped(function, rows):
    return jax.vmap(lambda row: function(*row))(rows)
