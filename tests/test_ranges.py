"""Every class with numbers refuses one outside its range when it is built; a new class is covered
the moment it is defined."""

import dataclasses
import inspect
from types import UnionType
from typing import get_args

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.ground.quantity import AbstractQuantified, public_name
from jaxclear.studies.design.cost import AbstractCost
from tests.test_architecture import own_classes

# What a field without a default may hold, by its type; numbers see `number_within`.
FILLERS = {str: "arm", float: 2.0, tuple[int, int]: (12, 1), tuple[int, ...]: (6, 7)}
FILLERS[tuple[str, ...]] = ("a", "b", "c")  # as many as a vector has numbers
FILLERS[AbstractCost] = jc.cost.Table((1e-5, 2e-5), (2.0, 1.0))  # others hold a cost themselves
COUNTS = {"quaternion": 4}  # numbers of a vector where they are not 3
BIG_ENOUGH = {"outer_radius": 2.0}  # numbers that another one bounds
# Numbers that bound each other.
TOGETHER = {
    "nominal": 1.0,
    "tolerances": (1e-5, 2e-5),
    "costs": (2.0, 1.0),
    "deviations": (0.0, 1.0),
    "shares": (0.5, 0.5),
    "times": (0.0, 1.0),
    "values": (0.0, 1.0),
    "low": -1.0,
    "high": 1.0,
}


def quantities(kind):
    return [field for field in dataclasses.fields(kind) if "unit" in field.metadata]


def arguments(kind):
    """Names under which numbers are given; others a class works out."""
    return inspect.signature(kind).parameters


def number_within(metadata):
    low = max(metadata.get("above", -np.inf), metadata.get("at_least", -np.inf))
    high = min(metadata.get("below", np.inf), metadata.get("at_most", np.inf))
    if np.isfinite(low) and np.isfinite(high):
        return 0.5 * (low + high)
    return low + 1.0 if np.isfinite(low) else min(high, 1.0)


def filler(field):
    kinds = get_args(field.type) if isinstance(field.type, UnionType) else (field.type,)
    if field.name in TOGETHER:
        return TOGETHER[field.name]
    if "unit" in field.metadata:
        number = BIG_ENOUGH.get(field.name, number_within(field.metadata))
        return (number,) * COUNTS.get(field.name, 3) if tuple in kinds else number
    for kind in kinds:
        if kind in FILLERS:
            return FILLERS[kind]
        if inspect.isclass(kind) and issubclass(kind, eqx.Module):
            return specimen(next(k for k in finals() if issubclass(k, kind)))
    return abs


def specimen(kind, **changes):
    """An object of this class: what has no default is filled in."""
    absent = dataclasses.MISSING
    needed = [
        f
        for f in dataclasses.fields(kind)
        if f.default is absent and f.default_factory is absent and f.name in arguments(kind)
    ]
    return kind(**({field.name: filler(field) for field in needed} | changes))


def finals():
    return [kind for kind in own_classes().values() if not inspect.isabstract(kind)]


NUMBERS = {
    f"{public_name(kind)}.{field.name}": (kind, field)
    for kind in finals()
    for field in quantities(kind)
    if not kind.__name__.startswith("Abstract") and field.name in arguments(kind)
}


def outside(metadata):
    if "above" in metadata:
        yield metadata["above"]
    if "at_least" in metadata:
        yield metadata["at_least"] - 1.0
    if "below" in metadata:
        yield metadata["below"]
    if "at_most" in metadata:
        yield metadata["at_most"] + 1.0
    yield from (np.nan, np.inf, -np.inf)


def test_the_walk_finds_classes_with_numbers():
    assert len(NUMBERS) > 100
    assert all(issubclass(kind, AbstractQuantified) for kind, _ in NUMBERS.values())


def test_numbers_outside_their_ranges_are_refused():
    for name, (kind, field) in NUMBERS.items():
        good = filler(field)
        for number in outside(field.metadata):
            bad = (*good[:-1], number) if isinstance(good, tuple) else number
            with pytest.raises(ValueError) as caught:
                specimen(kind, **{field.name: bad})
            sentence = str(caught.value)
            assert f"{number:g}" in sentence, name
            # a class that compares two numbers speaks first
            if "__check_init__" not in vars(kind):
                assert sentence.startswith(f"{public_name(kind)} has {field.name}")


def test_sentence_names_class_number_unit_and_range():
    sentences = {
        "integrator.MoreauJean has gamma = -1; it must be at least 0.": lambda: (
            jc.integrator.MoreauJean(gamma=-1)
        ),
        "integrator.NonColliding has relaxation = -1; it must be above 0.": lambda: (
            jc.integrator.NonColliding(relaxation=-1)
        ),
        "distribution.Uniform has half_width = -1 (in the varied number's unit); it must be above "
        "0.": lambda: jc.distribution.Uniform(-1),
        "Body has mass = nan kg; it must be above 0 and finite.": lambda: jc.Body(np.nan, 1.0),
        "Material has poisson_ratio = 0.7; it must be above -1 and at most 0.5.": lambda: (
            jc.Material(2e11, 0.7)
        ),
        "load.Gravity has acceleration[1] = inf m/s^2; it must be finite.": lambda: jc.load.Gravity(
            (0.0, np.inf)
        ),
    }
    for sentence, build in sentences.items():
        with pytest.raises(ValueError) as caught:
            build()
        assert str(caught.value) == sentence


def test_mechanism_names_the_part_whose_number_was_changed():
    arm = eqx.tree_at(lambda b: b.mass, jc.Body(1.0, 1.0), np.float64(-1.0))
    arm = jax.tree.map(jax.numpy.asarray, arm)
    pin = jc.Connection(jc.joint.Revolute(), "ground", "arm")
    with pytest.raises(ValueError, match='body "arm" has mass = -1 kg; it must be above 0'):
        jc.Mechanism({"arm": arm}, {"pin": pin})


def test_traced_numbers_are_not_checked():
    def scaled(mass):
        return jc.Body(-mass, 1.0).mass

    assert float(jax.jit(scaled)(2.0)) == -2.0
    assert jax.vmap(lambda g: jc.integrator.MoreauJean(gamma=g))(np.array([-1.0])).gamma[0] == -1
