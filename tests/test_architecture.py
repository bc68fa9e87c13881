"""The rules of the house that a program can read: who imports whom, what may be subclassed, who may
ask what of whom, how long things may be.
"""

import ast
import dataclasses
import importlib
import inspect
import pkgutil
from graphlib import CycleError, TopologicalSorter
from itertools import chain
from pathlib import Path

import equinox as eqx
import pytest

import jaxclear

ROOT = Path(jaxclear.__file__).parent
# Floors from below; rooms on one floor do not import each other.
FLOORS = (
    ("ground",),
    ("native",),
    ("laws", "complementarity"),
    ("components",),
    ("multibody",),
    ("formulations",),
    ("integrators", "scenes"),
    ("results",),
    ("errors",),
    ("simulation", "mesh"),
    ("statics",),
    ("studies",),
    ("files", "plot"),
    ("commands",),
)
FLOOR = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}
# Floors of the room of studies, from below; files, or folders, on one floor may import each other.
STUDIES = (
    # What a study asks, and what it answers.
    "base distribution inputs variable limit_state texts answer endless warned",
    "ledger",
    "mechanism_problem function_problem position_problem problem sensor "
    "chosen_integrator usual_integrator",
    "sampling scrambling sequential replicas statistics",
    "monte_carlo sweep screening worst_case advice",
    "campaign.result campaign.samples campaign.dataset campaign.recorded",
    "surface",
    "statistics.shapley statistics.sobol_indices sensitivity fidelity reliability design life "
    "identification",
    "campaign",
)
LONGEST_FILE, LONGEST_FUNCTION, MOST_ARGUMENTS, LONGEST_LINE = 600, 80, 9, 100
# What users call with names; each argument is a question that many ask.
FRONT_DOORS = {("simulation/simulate.py", "simulate"): 10}
# Libraries that a run does without: loaded when a table, a data set or a kernel is asked for.
LATE = {
    "jaxlie",
    "jinja2",
    "pandas",
    "xarray",
    "matplotlib",
    "llvmlite",
    "meshio",
    "optax",
    "scipy",
}
LATE |= {"dask", "distributed", "filelock", "k3d", "mujoco", "yaml", "zarr", "SALib"}
# The one class that its kind does not describe: gravity acts on every body, not on markers.
ASKED_BY_NAME = {"Gravity"}
NOTHING_NAMES = {"utils", "util", "helpers", "helper", "misc", "common", "core", "manager"}
FILES = sorted(ROOT.rglob("*.py"))


def module_name(path):
    parts = path.relative_to(ROOT.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path):
    """Every module that a file imports, inside functions too."""
    package = module_name(path).split(".")
    if path.name != "__init__.py":
        package = package[:-1]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            stem = ".".join([*base, *([node.module] if node.module else [])])
            yield stem
            yield from (f"{stem}.{alias.name}" for alias in node.names)


def room(module):
    parts = module.split(".")
    return parts[1] if parts[0] == "jaxclear" and len(parts) > 1 and parts[1] in FLOOR else None


def identify(path):
    return str(path.relative_to(ROOT))


def test_every_file_is_in_a_room():
    loose = [identify(path) for path in FILES if room(module_name(path)) is None]
    assert set(loose) <= {"__init__.py", "__main__.py", "offered_later.py"}


@pytest.mark.parametrize("path", FILES, ids=identify)
def test_imports_point_downward(path):
    here = room(module_name(path))
    if here is None:
        return
    for module in imports(path):
        there = room(module)
        assert there in (None, here) or FLOOR[there] < FLOOR[here], (
            f"{identify(path)} imports {module}"
        )
        assert module != "jaxclear" or here == "commands", (
            f"{identify(path)} imports the whole package"
        )


def floor_of_studies(module):
    """The floor of a module of the room of studies, that of the longest name given; None of others
    and of the room's own face."""
    own = module.removeprefix("jaxclear.studies.")
    known = {name: number for number, names in enumerate(STUDIES) for name in names.split()}
    fits = [name for name in known if f"{own}.".startswith(f"{name}.")]
    return known[max(fits, key=len)] if own != module and fits else None


@pytest.mark.parametrize("path", sorted((ROOT / "studies").rglob("*.py")), ids=identify)
def test_imports_between_studies_point_downward(path):
    name, stated = module_name(path), {own for names in STUDIES for own in names.split()}
    here = floor_of_studies(name)
    assert here is not None or name == "jaxclear.studies", "the file stands on no floor"
    # `from file import name` is the file; a name in it has its file's floor too.
    for module in imports(path):
        there = floor_of_studies(module)
        assert there is None or there <= here, f"{identify(path)} imports {module}"
    files = {module_name(file).removeprefix("jaxclear.studies.") for file in FILES}
    assert stated <= files


def test_no_circle_of_imports():
    """Neither between rooms nor within one."""
    known = {module_name(path): path for path in FILES}
    wants = {}
    for name, path in known.items():
        found = {m for m in imports(path) if m in known} - {name}
        # `from room import file` is the file, not the room's own face
        wants[name] = {m for m in found if not any(o.startswith(f"{m}.") for o in found)}
    try:
        TopologicalSorter(wants).prepare()
    except CycleError as error:
        pytest.fail(" imports ".join(reversed(error.args[1])))


@pytest.mark.parametrize("path", FILES, ids=identify)
def test_no_import_within_a_function(path):
    """But of libraries that most runs do without."""
    for function in functions(path):
        for node in ast.walk(function):
            if isinstance(node, ast.Import):
                named = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                named = [node.module or ""]
            else:
                continue
            late = {name.split(".")[0] for name in named}
            assert late <= LATE, f"{function.name} imports {', '.join(late)}"


def outside(path):
    return {module.split(".")[0] for module in imports(path)}


@pytest.mark.parametrize("path", FILES, ids=identify)
def test_solvers_stay_in_their_rooms(path):
    here = room(module_name(path))
    if FLOOR.get(here, 0) < FLOOR["integrators"]:
        assert "diffrax" not in outside(path)
    if identify(path) != "studies/design/lagrangian.py":
        assert "optax" not in outside(path)


@pytest.mark.parametrize("path", FILES, ids=identify)
def test_file_is_short_and_well_named(path):
    lines = path.read_text().splitlines()
    assert len(lines) <= LONGEST_FILE
    assert max(map(len, lines), default=0) <= LONGEST_LINE
    assert not set(path.relative_to(ROOT).with_suffix("").parts) & NOTHING_NAMES


def functions(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield node


@pytest.mark.parametrize("path", FILES, ids=identify)
def test_function_is_short_and_takes_few_arguments(path):
    for function in functions(path):
        assert function.end_lineno - function.lineno + 1 <= LONGEST_FUNCTION, function.name
        given = function.args
        arguments = [a.arg for a in chain(given.posonlyargs, given.args, given.kwonlyargs)]
        most = FRONT_DOORS.get((identify(path), function.name), MOST_ARGUMENTS)
        assert len(set(arguments) - {"self", "cls"}) <= most, function.name


@pytest.mark.parametrize("path", FILES, ids=identify)
def test_module_opens_with_what_it_decides(path):
    tree = ast.parse(path.read_text())
    assert not tree.body or ast.get_docstring(tree)


def modules():
    for info in pkgutil.walk_packages([str(ROOT)], "jaxclear."):
        if not info.name.endswith("__main__"):
            yield importlib.import_module(info.name)


def own_classes():
    found = {}
    for module in modules():
        for _, kind in inspect.getmembers(module, inspect.isclass):
            # Where it is defined, so that their order is not that of who imports whom.
            if issubclass(kind, eqx.Module) and kind.__module__ == module.__name__:
                found[f"{kind.__module__}.{kind.__qualname__}"] = kind
    return found


CLASSES = own_classes()


@pytest.mark.parametrize("name", CLASSES)
def test_class_is_abstract_or_final(name):
    for parent in CLASSES[name].__mro__[1:]:
        if parent.__module__.startswith("jaxclear"):
            assert parent.__name__.startswith("Abstract"), (
                f"{name} subclasses the final class {parent.__name__}"
            )


@pytest.mark.parametrize("name", CLASSES)
def test_abstract_class_has_no_fields(name):
    if CLASSES[name].__name__.startswith("Abstract"):
        assert not dataclasses.fields(CLASSES[name])


@pytest.mark.parametrize("path", FILES, ids=identify)
def test_no_super_and_no_hasattr(path):
    called = [
        n.func.id
        for n in ast.walk(ast.parse(path.read_text()))
        if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)
    ]
    # an exception hands its message to Python's own base class; a module of the platform may lack a
    # function
    lines = {"simulation/simulate.py": ["super"], "studies/ledger/batch.py": ["hasattr"]}
    assert [name for name in called if name in ("super", "hasattr")] == lines.get(
        identify(path), []
    )


def members(room_name):
    """Names of the laws or joints that are defined in a room: final classes of a family."""
    return {
        kind.__name__
        for kind in CLASSES.values()
        if kind.__module__.startswith(f"jaxclear.{room_name}.")
        and kind.__mro__[1].__name__.startswith("Abstract")
        and kind.__mro__[1].__module__.startswith(f"jaxclear.{room_name}.")
        and not kind.__name__.startswith("Abstract")
    }


@pytest.mark.parametrize("path", FILES, ids=identify)
def test_members_of_a_family_are_not_told_apart_elsewhere(path):
    """What a formulation wants of a law or a joint is a method of its family: a new member is one
    file.
    """
    for room_name in ("laws", "components"):
        if room(module_name(path)) == room_name:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.Call) or ast.unparse(node.func) != "isinstance":
                continue
            asked = {ast.unparse(n).split(".")[-1] for n in ast.walk(node.args[1])}
            named = asked & members(room_name) - ASKED_BY_NAME
            assert not named, f"line {node.lineno} asks for {', '.join(named)}"


@pytest.mark.parametrize("path", FILES, ids=identify)
def test_warnings_stand_at_the_users_line(path):
    """One function finds that line; a depth that is counted by hand is wrong with the next call."""
    said = [
        node.lineno
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "warnings.warn"
    ]
    assert not said or identify(path) == "ground/warning.py"
