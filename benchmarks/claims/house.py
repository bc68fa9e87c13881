"""Measures the house itself: lines of code, lengths of files and functions, units, sources, frames.

    python -m benchmarks.claims.house [--list] [--json FILE]

`--list` names what is beyond a limit. Everything is read from the source or from one traced run;
nothing is timed.
"""

import ast
import dataclasses
import importlib
import inspect
import pkgutil
import re
import tokenize
import tomllib
import traceback
from pathlib import Path
from typing import Any

import equinox as eqx

import jaxclear as jc
from benchmarks.measure import arguments, report

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
LIMITS = {
    "code [lines]": ("at most", PROJECT["tool"]["jaxclear"]["max_code_lines"]),
    "longest file [lines]": ("at most", 800),
    "longest function [lines]": ("at most", 80),
    "lines over 100 characters": ("at most", 0),
    "README [lines]": ("at most", 100),
    "public numbers with a unit [%]": ("at least", 95),
    "laws with a source [%]": ("at least", 100),
    "own frames from simulate to a law in a step": ("at most", 15),
}
WIDEST = 100
# Packages and folders whose Python files are looked at for the width of lines.
LOOKED_AT = ("jaxclear", "tests", "benchmarks")
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
WITHOUT_CODE = {tokenize.ENCODING, tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE}
WITHOUT_CODE |= {tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
# A unit in a docstring stands in brackets, as in "step [s]"; several parted by commas.
UNIT = re.compile(r"\[[^\]\n]{1,60}\]")


def package_files(root: Path = ROOT) -> list[Path]:
    """Python files of the package."""
    return sorted((root / "jaxclear").rglob("*.py"))


def lengths(root: Path = ROOT) -> dict[str, int]:
    """Lines of every file of the package."""
    return {str(p.relative_to(root)): len(p.read_text().splitlines()) for p in package_files(root)}


def count_code_lines(path: Path) -> int:
    """Lines of a Python file without docstrings, comments, imports and blank lines."""
    tree, code, free = ast.parse(path.read_text()), set(), set()
    for node in ast.walk(tree):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            free |= _lines_of(node)
        elif isinstance(node, (ast.Module, ast.ClassDef, *FUNCTIONS)):
            free |= _docstring_lines(node)
    with path.open("rb") as source:
        for token in tokenize.tokenize(source.readline):
            if token.type not in WITHOUT_CODE:
                code |= set(range(token.start[0], token.end[0] + 1))
    return len(code - free)


def _docstring_lines(node: ast.AST) -> set[int]:
    return _lines_of(node.body[0]) if ast.get_docstring(node, clean=False) is not None else set()


def _lines_of(node: ast.AST) -> set[int]:
    return set(range(node.lineno, node.end_lineno + 1))


def functions(root: Path = ROOT) -> list[tuple[str, int]]:
    """(place, lines without the docstring) of every function of the package."""
    return [
        (
            f"{path.relative_to(root)}:{node.lineno} {node.name}",
            len(_lines_of(node) - _docstring_lines(node)),
        )
        for path in package_files(root)
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, FUNCTIONS)
    ]


def wide_lines() -> list[str]:
    """Places of lines that are too long."""
    files = [p for folder in LOOKED_AT for p in sorted((ROOT / folder).rglob("*.py"))]
    return [
        f"{path.relative_to(ROOT)}:{number}"
        for path in files
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if len(line) > WIDEST
    ]


def public_classes() -> list[type]:
    """Every class with fields whose name does not begin with an underscore."""
    found = {}
    for info in pkgutil.walk_packages([str(ROOT / "jaxclear")], "jaxclear."):
        if info.name.endswith("__main__"):
            continue
        for _, kind in inspect.getmembers(importlib.import_module(info.name), inspect.isclass):
            if kind.__module__.startswith("jaxclear") and not kind.__name__.startswith("_"):
                found[f"{kind.__module__}.{kind.__qualname__}"] = kind
    return list(found.values())


def without_unit() -> tuple[list[str], int]:
    """(public numbers for which neither a field nor a docstring gives a unit, how many there are).

    Numbers are fields and parameters that are annotated as `Scalar`, `float` or an array of floats.
    A field of `quantity` carries its unit; others need their name and a unit in brackets in the
    docstring of the class or function.
    """
    lacking, count = [], 0
    for kind in public_classes():
        text = inspect.getdoc(kind) or ""
        if dataclasses.is_dataclass(kind):
            for field in dataclasses.fields(kind):
                if _is_number(field.type) and not field.metadata.get("static", False):
                    count += 1
                    if not field.metadata.get("unit") and not _mentions(text, field.name):
                        lacking.append(f"{kind.__module__}.{kind.__qualname__}.{field.name}")
    for name in jc.__all__:
        thing = getattr(jc, name)
        if inspect.isfunction(thing):
            text = inspect.getdoc(thing) or ""
            for parameter in inspect.signature(thing).parameters.values():
                if _is_number(parameter.annotation):
                    count += 1
                    if not _mentions(text, parameter.name):
                        lacking.append(f"{name}({parameter.name})")
    return lacking, count


def _is_number(annotation: Any) -> bool:
    text = annotation if isinstance(annotation, str) else str(annotation)
    return annotation is float or "Float[" in text or "float" in text.split(" | ")


def _mentions(text: str, name: str) -> bool:
    """Whether a docstring names a number and gives a unit in the same sentence or the next."""
    spoken = name.replace("_", " ")
    for found in re.finditer(rf"`{re.escape(name)}`|\b{re.escape(spoken)}\b", text):
        if UNIT.search(text[max(0, found.start() - 200) : found.end() + 200]):
            return True
    return False


def laws() -> list[type]:
    """Every concrete law of the package."""

    def below(kind: type) -> set[type]:
        return {kind}.union(*(below(child) for child in kind.__subclasses__()))

    families = (
        jc.contact.AbstractNormalLaw,
        jc.contact.AbstractElasticForce,
        jc.contact.AbstractDissipation,
        jc.friction.AbstractFrictionLaw,
        jc.wear.AbstractWearLaw,
    )
    found = set().union(*(below(family) for family in families))
    own = [law for law in found if law.__module__.startswith("jaxclear.")]
    return sorted(
        (law for law in own if not law.__name__.startswith(("Abstract", "_"))),
        key=lambda law: law.__name__,
    )


def without_source() -> list[str]:
    """Concrete laws whose docstring names no source."""
    return [law.__name__ for law in laws() if "Source:" not in (inspect.getdoc(law) or "")]


class _Witness(jc.contact.AbstractContactLaw):
    """A linear spring that remembers through which own functions it was reached."""

    frames: list = eqx.field(static=True)
    remembers_impact_speed, restitution = False, 1.0

    def normal_force(self, indentation, rate, impact_speed):
        stack = traceback.extract_stack()[:-1]
        own = [f"{f.filename}:{f.name}" for f in stack if f"{ROOT}/jaxclear/" in f.filename]
        self.frames.append(own)
        return self.elastic_force(indentation)

    def elastic_force(self, indentation):
        return 1e6 * (indentation + abs(indentation)) / 2


def frames_to_a_law() -> list[str]:
    """Own functions on the way from `simulate` to the force of a contact law in a step of a
    slider-crank, the shortest way."""
    frames: list[list[str]] = []
    rig = jc.scenes.slider_crank(contact=_Witness(frames=frames))
    jc.simulate(rig, 1e-3, save=2, integrator=jc.integrator.FixedStep(1e-4), verify=False)
    in_a_step = [own for own in frames if any("/integrators/" in frame for frame in own)]
    shortest = min(in_a_step, key=len)
    return shortest[[frame.endswith(":simulate") for frame in shortest].index(True) :]


def measure() -> dict[str, float]:
    """All measures by name."""
    every, (lacking, count) = functions(), without_unit()
    return {
        "code [lines]": sum(map(count_code_lines, package_files())),
        "longest file [lines]": max(lengths().values()),
        "longest function [lines]": max(lines for _, lines in every),
        "lines over 100 characters": len(wide_lines()),
        "README [lines]": len((ROOT / "README.md").read_text().splitlines()),
        "public numbers with a unit [%]": 100 * (1 - len(lacking) / count),
        "laws with a source [%]": 100 * (1 - len(without_source()) / len(laws())),
        "own frames from simulate to a law in a step": len(frames_to_a_law()),
        "package [lines]": sum(lengths().values()),
        "package [files]": len(lengths()),
    }


def offenders() -> dict[str, list[str]]:
    """What is beyond a limit, by measure."""
    return {
        "files over 800 lines": [f"{n} {p}" for p, n in lengths().items() if n > 800],
        "functions over 80 lines": [f"{n} {place}" for place, n in functions() if n > 80],
        "lines over 100 characters": wide_lines(),
        "numbers without a unit": without_unit()[0],
        "laws without a source": without_source(),
        "frames from simulate to a law": frames_to_a_law(),
    }


def main() -> None:
    """Prints the measures with their limits."""
    listing = {"action": "store_true", "help": "name what is beyond a limit"}
    options = arguments(str(__doc__), list=listing)
    rows = [
        {"measure": name, "value": value, "limit": " ".join(map(str, LIMITS.get(name, ())))}
        for name, value in measure().items()
    ]
    report("the house", rows, options)
    for name, places in offenders().items() if options.list else ():
        print(f"\n{name}: {len(places)}", *places, sep="\n  ")


if __name__ == "__main__":
    main()
