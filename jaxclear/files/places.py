"""Where a number of a mechanism stands, in words that a file can hold: `connections["B"].joint.
clearance`, as in the table of `mechanism.parameters()`. Names without strange letters may stand
behind a dot: `connections.B.joint.clearance`.
"""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import jax

from jaxclear.ground.wording import described, unknown
from jaxclear.multibody.mechanism import Mechanism

STEP = re.compile(r'\.?([A-Za-z_]\w*)|\[("(?:[^"\\]|\\.)*")\]|\[(\d{1,6})\]')
PREFIX = "mechanism."


@dataclass(frozen=True)
class NumberPlaces:
    """A function of a mechanism: the numbers at some places, which vary together."""

    paths: tuple[str, ...]

    def __call__(self, mechanism: Mechanism) -> Any:
        """The number, or several."""
        values = tuple(_follow_path(mechanism, path) for path in self.paths)
        return values[0] if len(values) == 1 else values


def steps_of(path: str) -> list[str | int]:
    """The names and indices of a path. Raises `ValueError` with a sentence for what is none."""
    rest, steps = path.removeprefix(PREFIX), []
    while rest:
        match = STEP.match(rest)
        if match is None:
            raise ValueError(
                f"{described(path)} is no place of a number; write one as "
                'connections["B"].joint.clearance, as mechanism.parameters() does.'
            )
        name, quoted, index = match.groups()
        steps.append(name or (json.loads(quoted) if quoted else int(index)))
        rest = rest[match.end() :]
    return steps


def _follow_path(mechanism: Any, path: str) -> Any:
    """What stands at a path. Raises `KeyError`, `AttributeError`, `IndexError` or `TypeError` where
    nothing does."""
    place = mechanism
    for step in steps_of(path):
        place = _take_step(place, step)
    return place


def _take_step(place: Any, step: str | int) -> Any:
    if isinstance(place, Mapping) or isinstance(step, int):
        return place[step]
    if step.startswith("_") or not is_dataclass(place):
        raise AttributeError(f"no {step}", name=step, obj=place)
    return getattr(place, step)


def check_numbers(where: NumberPlaces, mechanism: Mechanism) -> None:
    """Raises `ValueError` with a sentence where a place holds no number of the mechanism."""
    leaves = {id(leaf) for leaf in jax.tree.leaves(mechanism)}
    for path in where.paths:
        try:
            value = _follow_path(mechanism, path)
        except (KeyError, AttributeError, IndexError, TypeError):
            raise ValueError(_describe_wrong_step(path, mechanism)) from None
        if id(value) not in leaves:
            raise ValueError(
                f'"{path}" is {described(value)}; it must be the place of one number of the '
                "mechanism, as in the table of mechanism.parameters()."
            )


def _describe_wrong_step(path: str, mechanism: Any) -> str:
    """Which step of a path leads nowhere, and what there is instead."""
    place = mechanism
    for step in steps_of(path):
        names: list[str] = []
        if isinstance(place, Mapping):
            names = list(place)
        elif is_dataclass(place):
            names = [f.name for f in fields(place) if getattr(place, f.name) is not None]
        elif isinstance(place, tuple):
            names = [str(index) for index in range(len(place))]
        try:
            place = _take_step(place, step)
        except (KeyError, AttributeError, IndexError, TypeError):
            break
    return f'"{path}": {unknown("part", str(step), names, " there")}'


def places_in_words(where: Callable[[Mechanism], Any], mechanism: Mechanism) -> tuple[str, ...]:
    """The paths of the numbers at which a function of a mechanism points, found by their position:
    two parts may share a law. Raises `ValueError` where it points at nothing of it."""
    leaves, structure = jax.tree.flatten(mechanism)
    marks = [_Mark() for _ in leaves]
    marked = jax.tree.unflatten(structure, marks)
    paths = [path for path, _ in jax.tree_util.tree_leaves_with_path(mechanism)]
    by_mark = {id(mark): path for mark, path in zip(marks, paths, strict=True)}
    flags = jax.tree.leaves(where(marked))
    if not flags or any(id(mark) not in by_mark for mark in flags):
        raise ValueError("its `where` computes something instead of pointing at numbers.")
    return tuple(_format_path(by_mark[id(mark)]) for mark in flags)


class _Mark:
    """Stands for a number of a mechanism, to be found again."""


def _format_path(path: Any) -> str:
    words = []
    for step in path:
        if isinstance(step, jax.tree_util.GetAttrKey):
            words.append(f".{step.name}")
        elif isinstance(step, jax.tree_util.DictKey):
            words.append(f"[{json.dumps(step.key, ensure_ascii=False)}]")
        else:
            words.append(f"[{step.idx}]")
    return "".join(words).removeprefix(".")
