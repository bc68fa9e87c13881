"""Bad inputs from the public surface: every constructor and function, every argument, a list of
wrong kinds and wrong ranges.

What an argument may hold is said here once more, beside the package, by a word: "number", "length"
(a number above 0), "name", "flag", "count", "part" and so on. Ranges are those of the fields.

Legitimate, so not in the list: True and False for `friction` and `wear` of the scenes; 0 where a
field allows it; a count given as a NumPy integer; text in place of a marker of a `Connection`; an
empty dictionary of loads, starts or speeds; `None` for what may be absent; a whole number of saving
times given as 11.0. What the engine alone calls (formulations, numerics, poses, problems of a step)
is checked where its numbers come from."""

import dataclasses
import inspect
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

import jaxclear as jc


class Case(NamedTuple):
    """One mistake: a group, a label, what is called, and words one of which the answer must
    name."""

    group: str
    label: str
    call: Callable[[], Any]
    names: tuple[str, ...]


BODY = jc.Body(1.0, 1e-2)
NEVER = {"text": "1.0", "list": [1.0], "array": np.ones(3), "dictionary": {}, "flag": True}
NEVER |= {"body": BODY, "class": jc.Body, "complex": 1j, "too large": 10**400}
NEVER |= {"nan": float("nan"), "inf": float("inf")}
KINDS: dict[str, dict[str, Any]] = {
    "number": NEVER,
    "positive": NEVER | {"zero": 0.0, "negative": -1.0},
    "vector": {k: v for k, v in NEVER.items() if k not in ("list", "array")}
    | {"one number": 3.0, "five numbers": (1.0,) * 5, "nan in it": (0.0, float("nan"))},
    "name": {"number": 3, "none": None, "list": ["a"], "body": BODY, "flag": True},
    "word": {"number": 3, "none": None, "another": "magic", "list": ["a"], "body": BODY},
    "flag": {"text": "no", "number": 2, "none": None, "array": np.ones(2), "body": BODY},
    "count": {"zero": 0, "negative": -1, "part": 2.5, "text": "3", "flag": True}
    | {"nan": float("nan"), "array": np.ones(2), "body": BODY},
    "seed": {"negative": -1, "part": 2.5, "text": "3", "flag": True, "body": BODY},
    "part": {"text": "steel", "number": 3.0, "list": [], "body": BODY, "class": jc.wear.Archard}
    | {"another family": jc.Projection(), "module": jc.contact, "function": abs},
    "function": {"text": "sin", "number": 3.0, "list": [], "body": BODY, "class": jc.Body},
}
NONE = {"none": None}


def wrong(kind: str, optional: bool) -> Iterator[tuple[str, Any]]:
    """Labels and wrong values of a kind; None is wrong where the argument is not optional."""
    yield from KINDS[kind].items()
    if not optional and "none" not in KINDS[kind]:
        yield from NONE.items()


def needed(kind: type) -> dict[str, Any]:
    """Good arguments for what has no default."""
    return {name: value for name, value in GOOD.items() if name in _required(kind)} | SPECIAL.get(
        kind, {}
    )


def _required(thing: Any) -> list[str]:
    parameters = inspect.signature(thing).parameters.values()
    return [p.name for p in parameters if p.default is p.empty]


STEEL, MARKER = jc.Material(2e11, 0.3), jc.Marker("arm")
GOOD = {
    "mass": 1.0,
    "inertia": (1.0, 1.0, 1.0),
    "body": "arm",
    "young_modulus": 2e11,
    "poisson_ratio": 0.3,
    "contact": jc.contact.Hertz(),
    "law": jc.wear.Archard(),
    "speed": 1.0,
    "duration": 1.0,
    "amplitude": 1.0,
    "frequency": 1.0,
    "function": lambda t: 0.1 * t,
    "marker": MARKER,
    "bearing": MARKER,
    "journal": MARKER,
    "start": MARKER,
    "end": jc.Marker("ground"),
    "connection": "pin",
    "value": 1.0,
    "joint": "B",
    "reference": np.zeros((3, 3)),
    "tip": MARKER,
    "standard_deviation": 1.0,
    "half_width": 1.0,
    "bound": 1.0,
    "inner": STEEL,
    "outer": STEEL,
    "inner_radius": 1.0,
    "outer_radius": 2.0,
    "elastic": jc.contact.elastic.Hertz(),
    "of_order": 4,
}
SPECIAL = {
    jc.load.Force: {"value": (1.0, 0.0)},
    jc.load.Spring: {"stiffness": 1.0},
    jc.load.JointSpring: {"stiffness": 1.0},
    jc.stiffness.Shape: {"inner_radius": 1.0, "outer_radius": 2.0},
}
# Fields whose type does not say it.
BY_NAME = {"unit": "name", "inertia": "inertia", "reference": "part", "method": "word"}
PLACES = ("", "clearance", "contact", "contact.elastic", "contact.cylinder", "contact.dissipation")
PLACES += ("distribution", "drive", "friction", "integrator", "joint", "load", "material")
PLACES += ("response", "stiffness", "wear", "complementarity")
# What a field takes though its kind does not: one number about z; a body's name for its frame, a
# connection's for a tuple of one.
ALLOWED = {("Body", "inertia", "one number"), ("Torque", "value", "one number")}
ALLOWED |= {("PointingAngle", "tip", "text"), ("PointingAngle", "through", "text")}
ALLOWED |= {("PositionError", "body", "text")}
# Made by the package alone, from what it has checked: reports, states and problems of a step.
INNER = {"Trajectory", "Solution", "Iterate", "JointFriction", "FrictionContact", "LCP", "Advance"}
INNER |= {"HorizontalLCP", "Interval", "GroupTerm", "PermanentRevolute", "PermanentPrismatic"}
INNER |= {"PermanentSpherical"}
INNER |= {"SimulationError", "Outcome", "MarkerMotion", "Action", "Effect", "ContactCandidate"}
INNER |= {"ContactLaws", "CarriedContact", "CarryingEnd", "Scalar", "Check", "Checks", "Figure"}
# Written out in `functions`, since their arguments are no fields.
WRITTEN = {
    "Connection",
    "ContactForce",
    "Marker",
    "Measurement",
    "Mechanism",
    "Problem",
    "Variable",
}


def place(path: str) -> Any:
    """A module by its public path."""
    found: Any = jc
    for name in filter(None, path.split(".")):
        found = getattr(found, name)
    return found


def classes() -> dict[str, type]:
    """Every class that a user builds, by public name."""
    found = {}
    for path in PLACES:
        for name in place(path).__all__:
            kind = getattr(place(path), name)
            inner = name.startswith("Abstract") or name in INNER | WRITTEN
            if inspect.isclass(kind) and dataclasses.is_dataclass(kind) and not inner:
                found[f"{path}.{name}".lstrip(".")] = kind
    return found


def field_kind(field: dataclasses.Field) -> tuple[str, bool]:
    """(kind, optional) of a field; "" for one that this file cannot judge."""
    text = str(field.type)
    optional = "None" in text or field.default is None
    if field.name in BY_NAME:
        return BY_NAME[field.name].replace("inertia", "vector"), optional
    if "unit" in field.metadata:
        return ("vector" if "tuple" in text else "number"), optional
    if field.type in (str, bool, int) or text.startswith(("int |", "str |")):
        simple = {"str": "name", "bool": "flag", "int": "count"}
        kind = simple[getattr(field.type, "__name__", text.split(" ")[0])]
        low = field.metadata.get("at_least", 1)
        return ("seed" if kind == "count" and low == 0 else kind), optional
    if "Callable" in text:
        return "function", optional
    if text.startswith("tuple"):
        return "vector", optional
    modules = ("jaxclear", "diffrax")
    return ("part" if any(f"{m}." in text for m in modules) else ""), optional


def outside(metadata: Any) -> dict[str, float]:
    """Numbers beyond a field's range."""
    found = {}
    if "above" in metadata:
        found |= {"lower end": metadata["above"], "below": metadata["above"] - 1.0}
    if "at_least" in metadata:
        found["below"] = metadata["at_least"] - 1.0
    if "at_most" in metadata:
        found["above"] = metadata["at_most"] + 1.0
    if "below" in metadata:
        found["upper end"] = metadata["below"]
    return found


def constructors() -> Iterator[Case]:
    """Every field of every class, a misspelt and a missing argument."""
    for name, kind in classes().items():
        good, short = needed(kind), name.rpartition(".")[2]
        for field in dataclasses.fields(kind):
            what, optional = field_kind(field)
            if not what or not field.init:
                continue
            values = dict(wrong(what, optional)) | outside(field.metadata)
            if "Callable" in str(field.type):  # a function of time may stand there
                values.pop("class" if what == "function" else "", None)
            for label, value in values.items():
                if (kind.__name__, field.name, label) in ALLOWED:
                    continue
                given = good | {field.name: value}
                yield Case(
                    "constructors",
                    f"{name}({field.name}: {label})",
                    lambda kind=kind, given=given: kind(**given),
                    (field.name, short),
                )
        if good:
            first = next(iter(good))
            bad = {k: v for k, v in good.items() if k != first} | {first + "s": good[first]}
            yield Case("names", f"{name}({first}s=)", lambda k=kind, g=bad: k(**g), (first, short))
            rest = {k: v for k, v in good.items() if k != first}
            if first in _required(kind):
                yield Case(
                    "names", f"{name}() without {first}", lambda k=kind, g=rest: k(**g), (first,)
                )


def products() -> Iterator[Case]:
    """The contact laws that are functions."""
    for name in jc.contact.__all__:
        law = getattr(jc.contact, name)
        if inspect.isfunction(law):
            for number in inspect.signature(law).parameters:
                for label in ("text", "array", "flag", "nan", "body", "class"):
                    given = {number: NEVER[label]}
                    call = lambda law=law, given=given: law(**given)
                    yield Case(
                        "constructors", f"contact.{name}({number}: {label})", call, (number,)
                    )
            yield Case(
                "names", f"contact.{name}(stifness=)", lambda law=law: law(stifness=1.0), ("stif",)
            )


def members() -> Iterator[Case]:
    """A misspelt name in every module, and families built by themselves."""
    for path in PLACES:
        for name in place(path).__all__:
            if inspect.ismodule(getattr(place(path), name)):
                continue
            call = lambda path=path, name=name: getattr(place(path), name + "z")
            yield Case("names", f"{path}.{name}z", call, (name,))
            thing = getattr(place(path), name)
            if name.startswith("Abstract") and inspect.isclass(thing):
                yield Case("names", f"{path}.{name}()", lambda thing=thing: thing(), (name,))
