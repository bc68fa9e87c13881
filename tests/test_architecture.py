"""The rules of the house that a program can read: who imports whom, what may be subclassed, how
long a file may be.
"""

import ast
import importlib
import inspect
import pkgutil
from pathlib import Path

import equinox as eqx
import pytest

import jaxclear

ROOT = Path(jaxclear.__file__).parent
# From below; `scenes` holds ready mechanisms, and uses the package as a user would.
ROOMS = (
    "native",
    "ground",
    "complementarity",
    "laws",
    "components",
    "multibody",
    "formulations",
    "integrators",
    "results",
    "simulation",
    "studies",
    "plot",
    "scenes",
    "commands",
)
LONGEST_FILE = 500
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
    return parts[1] if parts[0] == "jaxclear" and len(parts) > 1 and parts[1] in ROOMS else None


def identify(path):
    return str(path.relative_to(ROOT))


def test_every_file_is_in_a_room():
    loose = [identify(path) for path in FILES if room(module_name(path)) is None]
    assert set(loose) <= {"__init__.py", "__main__.py"}


@pytest.mark.parametrize("path", FILES, ids=identify)
def test_imports_point_downward(path):
    here = room(module_name(path))
    if here is None:
        return
    for module in imports(path):
        there = room(module)
        assert there is None or ROOMS.index(there) <= ROOMS.index(here), (
            f"{identify(path)} imports {module}"
        )
        assert module != "jaxclear" or here in ("scenes", "commands"), (
            f"{identify(path)} imports the whole package"
        )


def outside(path):
    return {module.split(".")[0] for module in imports(path)}


@pytest.mark.parametrize("path", FILES, ids=identify)
def test_solvers_stay_in_their_rooms(path):
    here = room(module_name(path))
    if here in ROOMS[: ROOMS.index("integrators")]:
        assert "diffrax" not in outside(path)
    if identify(path) != "studies/design.py":
        assert "optax" not in outside(path)


@pytest.mark.parametrize("path", FILES, ids=identify)
def test_file_is_short_and_well_named(path):
    assert len(path.read_text().splitlines()) <= LONGEST_FILE
    assert not set(path.relative_to(ROOT).with_suffix("").parts) & NOTHING_NAMES


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
    for module in (jaxclear, *modules()):
        for _, kind in inspect.getmembers(module, inspect.isclass):
            if issubclass(kind, eqx.Module) and kind.__module__.startswith("jaxclear"):
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
        assert not [field for field in CLASSES[name].__dict__.get("__dataclass_fields__", {})]


@pytest.mark.parametrize("path", FILES, ids=identify)
def test_no_super_and_no_hasattr(path):
    called = [
        n.func.id
        for n in ast.walk(ast.parse(path.read_text()))
        if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)
    ]
    # an exception hands its message to Python's own base class; a module of the platform may lack a
    # function
    lines = {"simulation/simulate.py": ["super"], "studies/batch.py": ["hasattr"]}
    assert [name for name in called if name in ("super", "hasattr")] == lines.get(
        identify(path), []
    )
