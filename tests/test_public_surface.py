"""The public surface is pinned: every public name with its signature, in
refdata/public_surface.json. `python -m tests.test_public_surface` writes that file anew."""

import dataclasses
import enum
import importlib
import inspect
import json
import pkgutil
import pydoc
import re
from pathlib import Path
from types import ModuleType

import pytest

import jaxclear
from jaxclear.ground.quantity import AbstractQuantified

PINNED = Path(__file__).parent / "refdata" / "public_surface.json"


def public_modules():
    """Every module that a user reaches from `jaxclear` by public names."""
    modules, left = {}, [("jaxclear", jaxclear)]
    while left:
        path, place = left.pop()
        modules[path] = place
        inner = {name: getattr(place, name) for name in place.__all__}
        left += [(f"{path}.{n}", m) for n, m in inner.items() if isinstance(m, ModuleType)]
    # heavy libraries are loaded with it, so a user imports it by itself
    modules["jaxclear.plot"] = importlib.import_module("jaxclear.plot")
    return modules


def signature(thing):
    """Its arguments and their defaults; not its types, which each version of JAX prints anew."""
    try:
        found = inspect.signature(thing)
    except (TypeError, ValueError):
        return ""
    bare = [p.replace(annotation=p.empty) for p in found.parameters.values()]
    text = str(found.replace(parameters=bare, return_annotation=found.empty))
    text = re.sub(r" at 0x[0-9a-f]+", "", text)
    return re.sub(r"<dataclasses\._MISSING_TYPE object>", "MISSING", text)


def described(thing):
    if inspect.isclass(thing):
        return class_lines(thing)
    if callable(thing):
        return "function" + signature(thing)
    return "number or object"


def class_lines(kind):
    if issubclass(kind, enum.Enum):
        return {"enumeration": [member.name for member in kind]}
    lines = {"class": signature(kind)}
    if dataclasses.is_dataclass(kind):
        lines |= {
            field.name: f"[{field.metadata['unit']}]"
            for field in dataclasses.fields(kind)
            if "unit" in field.metadata
        }
    for name, member in inspect.getmembers(kind):
        if not name.startswith("_") and owner(kind, name).startswith("jaxclear"):
            if inspect.isfunction(member):
                lines[f"{name}()"] = signature(member)
            elif isinstance(member, property):
                lines[name] = "property"
    return lines


def owner(kind, name):
    """The module of the class that defines an attribute."""
    return next(parent.__module__ for parent in kind.__mro__ if name in vars(parent))


def surface():
    return {
        f"{place}.{name}": described(getattr(module, name))
        for place, module in public_modules().items()
        for name in sorted(module.__all__)
        if not isinstance(getattr(module, name), ModuleType)
    }


def test_public_surface_is_as_pinned():
    """A change of the interface is a decision, and is told to the users."""
    pinned, found = json.loads(PINNED.read_text()), surface()
    changed = [n for n in {**pinned, **found} if pinned.get(n) != found.get(n)]
    assert not changed, (
        f"the public surface changed: {', '.join(changed)}. If that is intended, add a line to "
        "CHANGELOG.md and write the pin anew with `python -m tests.test_public_surface`."
    )


@pytest.mark.parametrize("place", public_modules())
def test_public_module_says_what_it_offers(place):
    module = public_modules()[place]
    assert len(set(module.__all__)) == len(module.__all__)
    assert not [name for name in module.__all__ if not hasattr(module, name)]
    assert not [name for name in module.__all__ if name.startswith("_")]


# A joint with wear, a product of laws, a scene, a mechanism and a solver on groups build these
# themselves.
INNER = {
    *("AbstractFreeVariable", "AbstractLaw", "AbstractLean", "AbstractLikeIdeal", "AreaMap"),
    *("AbstractPlaceZone", "AbstractRound", "AbstractSurface", "AbstractThreshold", "AsNeeded"),
    *("CylinderMap", "FitSizes", "ImpactMemory", "JournalFilm", "MobileJournal", "SphereMap"),
    *("PeriodicTorque", "StepTorque", "WallMap", "ZoneVariable", "_ServoOnMotor"),
}
# A folder of samples remembers its problem by one.
INNER |= {"RecordedExperiment", "RecordedVariable", "StateGroup"}
# What functions make problems of.
INNER |= {"RunExperiment", "PositionExperiment", "FunctionExperiment", "LifeExperiment"}
# What a beam becomes in a mechanism.
INNER |= {"_Elasticity", "Piece"}
# Laws of which a number says which acts, in the sample of an identification; what sensors are.
INNER |= {"ChosenDissipation", "ChosenFriction", "AbstractSignal"}
# A load as steps see it that find its force themselves.
INNER |= {"OverStep", "StopOfRatio"}


def family_classes():
    """Every class of the package that has numbers."""
    for info in pkgutil.walk_packages(jaxclear.__path__, "jaxclear."):
        if not info.name.endswith("__main__"):
            importlib.import_module(info.name)
    found, left = [], [AbstractQuantified]
    while left:
        kind = left.pop()
        left += kind.__subclasses__()
        found.append(kind)
    return [kind for kind in found if kind.__module__.startswith("jaxclear.")]


def test_every_family_is_public():
    """What a stranger derives from, and every member that a user may choose, has a public name."""
    offered = {
        getattr(module, name)
        for module in public_modules().values()
        for name in module.__all__
        if inspect.isclass(getattr(module, name))
    }
    assert {kind.__name__ for kind in family_classes() if kind not in offered} == INNER


LAWS = [
    kind
    for place in ("contact", "friction", "wear", "distribution", "integrator")
    for name in getattr(jaxclear, place).__all__
    if inspect.isclass(kind := getattr(getattr(jaxclear, place), name))
    and issubclass(kind, AbstractQuantified)
    and not name.startswith("Abstract")
]


@pytest.mark.parametrize("law", LAWS, ids=lambda kind: kind.__name__)
def test_numbers_that_could_be_swapped_are_given_by_name(law):
    """Coulomb(0.1, 0.2) would not say which of the two is the static coefficient."""
    if sum("unit" in field.metadata for field in dataclasses.fields(law)) > 1:
        with pytest.raises((TypeError, ValueError)):
            law(0.25, 0.5)


def test_completion_shows_public_names_alone_and_families_are_imported_by_name():
    for path, place in public_modules().items():
        assert dir(place) == sorted(place.__all__), path
        assert importlib.import_module(path) is place


def test_signatures_name_types_as_they_are_typed():
    """A user reads them by `help`; the room of a class is no business of his."""
    functions = [f for f in vars(jaxclear).values() if inspect.isfunction(f)]
    shown = [str(inspect.signature(f)) for f in functions if f.__name__ in jaxclear.__all__]
    assert shown and not re.findall(r"jaxclear(?:\.[a-z_]+){2,}", " ".join(shown))
    assert "mechanism: jaxclear.Mechanism" in " ".join(shown)


@pytest.mark.parametrize("kind", [jaxclear.Problem, jaxclear.Trajectory, jaxclear.joint.Revolute])
def test_help_of_a_class_shows_what_users_call(kind):
    """Special methods are Python's and equinox's; a page of them hid those of a class."""
    page = pydoc.render_doc(kind, renderer=pydoc.plaintext)
    assert not re.findall(r"__\w+__", page)
    head, summary = page.split("\n")[3], kind.__doc__.split("\n")[0]
    assert not re.findall(r"jaxclear(?:\.[a-z_]+){2,}", head)
    assert summary in "\n".join(page.split("\n")[:6])


if __name__ == "__main__":
    PINNED.write_text(json.dumps(surface(), indent=1, sort_keys=True) + "\n")
