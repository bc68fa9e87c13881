"""The rules of the house that a program can read: who imports whom, what may be subclassed, who may
ask what of whom, how long things may be. Each rule lists all that is against it."""

import ast
import functools
import importlib
import inspect
import pkgutil
import tokenize
import tomllib
from graphlib import CycleError, TopologicalSorter
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
    ("files", "fmu", "plot"),
    ("commands",),
)
FLOOR = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}
# Floors of the room of studies, from below; files, or folders, on one floor may import each other.
STUDIES = (
    # What a study asks, and what it answers.
    "experiment distribution inputs variable responses chosen_integrator usual_integrator "
    "run_experiment problem",
    "function_problem position_problem sensor tolerance",
    "limit_state store.digest answer infinite_responses run_warnings",
    "store.store store.batch",
    "sampling scrambling sequential replicas statistics",
    "monte_carlo sweep screening worst_case advice",
    "store",
    "surface",
    "statistics.shapley statistics.sobol_indices sensitivity fidelity reliability design life "
    "identification",
)
LONGEST_FILE, LONGEST_FUNCTION, LONGEST_LINE = 800, 80, 100
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
LATE |= {"dask", "distributed", "filelock", "k3d", "mujoco", "yaml", "zarr"}
# The one class that its kind does not describe: gravity acts on every body, not on markers.
ASKED_BY_NAME = {"Gravity"}
NOTHING_NAMES = {"utils", "util", "helpers", "helper", "misc", "common", "core", "manager"}
WITHOUT_CODE = {tokenize.ENCODING, tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE}
WITHOUT_CODE |= {tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
FILES = sorted(ROOT.rglob("*.py"))


@functools.cache
def nodes(path):
    """All that a file's syntax tree consists of, outermost first."""
    return tuple(ast.walk(ast.parse(path.read_text())))


def module_name(path):
    parts = path.relative_to(ROOT.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@functools.cache
def imports(path):
    """Every module that a file imports, inside functions too."""
    package = module_name(path).split(".")
    if path.name != "__init__.py":
        package = package[:-1]
    found = []
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            stem = ".".join([*base, *([node.module] if node.module else [])])
            found += [stem, *(f"{stem}.{alias.name}" for alias in node.names)]
    return tuple(found)


def functions(path):
    return [n for n in nodes(path) if isinstance(n, (ast.FunctionDef, ast.AsyncFunctionDef))]


def calls(path):
    return [node for node in nodes(path) if isinstance(node, ast.Call)]


def room(module):
    parts = module.split(".")
    return parts[1] if parts[0] == "jaxclear" and len(parts) > 1 and parts[1] in FLOOR else None


def identify(path):
    return str(path.relative_to(ROOT))


def holds(rule, paths=FILES):
    """A rule of one file, which gives what is against it in words, holds in all of them."""
    against = [f"{identify(path)}: {fault}" for path in paths for fault in rule(path)]
    assert not against, "\n".join(against)


def test_every_file_is_in_a_room():
    loose = [identify(path) for path in FILES if room(module_name(path)) is None]
    assert set(loose) <= {"__init__.py", "__main__.py", "lazy_names.py"}


def test_imports_point_downward():
    def rule(path):
        here = room(module_name(path))
        for module in imports(path) if here is not None else ():
            there = room(module)
            if there not in (None, here) and FLOOR[there] >= FLOOR[here]:
                yield f"imports {module}"
            if module == "jaxclear" and here != "commands":
                yield "imports the whole package"

    holds(rule)


def floor_of_studies(module):
    """The floor of a module of the room of studies, that of the longest name given; None of others
    and of the room's own face."""
    own = module.removeprefix("jaxclear.studies.")
    known = {name: number for number, names in enumerate(STUDIES) for name in names.split()}
    fits = [name for name in known if f"{own}.".startswith(f"{name}.")]
    return known[max(fits, key=len)] if own != module and fits else None


def test_imports_between_studies_point_downward():
    def rule(path):
        name = module_name(path)
        here = floor_of_studies(name)
        if here is None and name != "jaxclear.studies":
            yield "stands on no floor"
            return
        # `from file import name` is the file; a name in it has its file's floor too.
        for module in imports(path):
            there = floor_of_studies(module)
            if there is not None and there > here:
                yield f"imports {module}"

    holds(rule, sorted((ROOT / "studies").rglob("*.py")))
    files = {module_name(file).removeprefix("jaxclear.studies.") for file in FILES}
    assert {own for names in STUDIES for own in names.split()} <= files


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


def test_no_import_within_a_function():
    """But of libraries that most runs do without."""

    def rule(path):
        for function in functions(path):
            for node in ast.walk(function):
                if isinstance(node, ast.Import):
                    named = [alias.name for alias in node.names]
                elif isinstance(node, ast.ImportFrom):
                    named = [node.module or ""]
                else:
                    continue
                for name in named:
                    if name.split(".")[0] not in LATE:
                        yield f"{function.name} imports {name}"

    holds(rule)


def test_solvers_stay_in_their_rooms():
    def rule(path):
        outside = {module.split(".")[0] for module in imports(path)}
        if FLOOR.get(room(module_name(path)), 0) < FLOOR["integrators"] and "diffrax" in outside:
            yield "imports diffrax"
        if identify(path) != "studies/design/lagrangian.py" and "optax" in outside:
            yield "imports optax"

    holds(rule)


def test_files_are_short_and_well_named():
    def rule(path):
        lines = path.read_text().splitlines()
        if len(lines) > LONGEST_FILE:
            yield f"{len(lines)} lines"
        if max(map(len, lines), default=0) > LONGEST_LINE:
            yield "a line is too long"
        yield from set(path.relative_to(ROOT).with_suffix("").parts) & NOTHING_NAMES

    holds(rule)


def lines_of(node):
    return set(range(node.lineno, node.end_lineno + 1))


def docstring_lines(node):
    return lines_of(node.body[0]) if ast.get_docstring(node, clean=False) is not None else set()


def test_functions_are_short():
    """A docstring may be as long as it must."""

    def rule(path):
        for function in functions(path):
            if len(lines_of(function) - docstring_lines(function)) > LONGEST_FUNCTION:
                yield f"{function.name} is too long"

    holds(rule)


def count_code_lines(path):
    """Lines of a Python file without docstrings, comments, imports and blank lines."""
    code, free = set(), set()
    for node in nodes(path):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            free |= lines_of(node)
        elif isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            free |= docstring_lines(node)
    with path.open("rb") as source:
        for token in tokenize.tokenize(source.readline):
            if token.type not in WITHOUT_CODE:
                code |= set(range(token.start[0], token.end[0] + 1))
    return len(code - free)


def test_the_package_keeps_to_its_number_of_code_lines():
    """What a capability adds is taken away elsewhere."""
    project = tomllib.loads((ROOT.parent / "pyproject.toml").read_text())
    limit = project["tool"]["jaxclear"]["max_code_lines"]
    lines = sum(map(count_code_lines, FILES))
    assert lines <= limit, (
        f"jaxclear has {lines} lines of code (docstrings, comments, imports and blank lines are "
        f"free), {lines - limit} more than [tool.jaxclear] max_code_lines = {limit} in "
        "pyproject.toml. Remove as many: what the change replaces, an option that no page, scene "
        "or command uses, a function that only forwards. Raise the number only by agreement."
    )


def test_code_lines_are_what_neither_explains_nor_imports(tmp_path):
    file = tmp_path / "counted.py"
    file.write_text(
        '"""A docstring\nof two lines."""\n\nimport ast\nfrom os import (\n    path,\n)\n\n'
        '# a comment\nTEXT = """a text\n# is code"""  # in two lines\n\n\n'
        'def double(x):\n    """A docstring."""\n    return (\n\n        2 * x\n    )\n'
    )
    assert count_code_lines(file) == 6


def test_modules_open_with_what_they_decide():
    def rule(path):
        (tree, *_) = nodes(path)
        if tree.body and not ast.get_docstring(tree):
            yield "has no docstring"

    holds(rule)


def modules():
    for info in pkgutil.walk_packages([str(ROOT)], "jaxclear."):
        if not info.name.endswith("__main__"):
            yield importlib.import_module(info.name)


@functools.cache
def own_classes():
    found = {}
    for module in modules():
        for _, kind in inspect.getmembers(module, inspect.isclass):
            # Where it is defined, so that their order is not that of who imports whom.
            if issubclass(kind, eqx.Module) and kind.__module__ == module.__name__:
                found[f"{kind.__module__}.{kind.__qualname__}"] = kind
    return found


def test_classes_are_abstract_or_final():
    against = [
        f"{name} subclasses the final class {parent.__name__}"
        for name, kind in own_classes().items()
        for parent in kind.__mro__[1:]
        if parent.__module__.startswith("jaxclear") and not parent.__name__.startswith("Abstract")
    ]
    assert not against


def test_no_super_and_no_hasattr():
    # an exception hands its message to Python's own base class; a module of the platform may lack a
    # function
    allowed = {"simulation/simulate.py": ["super"], "studies/store/batch.py": ["hasattr"]}

    def rule(path):
        named = [call.func.id for call in calls(path) if isinstance(call.func, ast.Name)]
        found = [name for name in named if name in ("super", "hasattr")]
        return [] if found == allowed.get(identify(path), []) else [f"calls {found}"]

    holds(rule)


@functools.cache
def members(room_name):
    """Names of the laws or joints that are defined in a room: final classes of a family."""
    return {
        kind.__name__
        for kind in own_classes().values()
        if kind.__module__.startswith(f"jaxclear.{room_name}.")
        and kind.__mro__[1].__name__.startswith("Abstract")
        and kind.__mro__[1].__module__.startswith(f"jaxclear.{room_name}.")
        and not kind.__name__.startswith("Abstract")
    }


def test_members_of_a_family_are_not_told_apart_elsewhere():
    """What a formulation wants of a law or a joint is a method of its family: a new member is one
    file."""

    def rule(path):
        foreign = {"laws", "components"} - {room(module_name(path))}
        kinds = set[str]().union(*map(members, foreign)) - ASKED_BY_NAME
        for node in calls(path):
            if isinstance(node.func, ast.Name) and node.func.id == "isinstance":
                asked = {ast.unparse(n).split(".")[-1] for n in ast.walk(node.args[1])}
                for name in asked & kinds:
                    yield f"line {node.lineno} asks for {name}"

    holds(rule)


def test_warnings_stand_at_the_users_line():
    """One function finds that line; a depth that is counted by hand is wrong with the next call."""

    def rule(path):
        said = [call.lineno for call in calls(path) if ast.unparse(call.func) == "warnings.warn"]
        return [] if identify(path) == "ground/warning.py" else said

    holds(rule)
