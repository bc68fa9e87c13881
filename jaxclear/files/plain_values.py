"""Values of a file as numbers and texts; what they are not is refused by line and place."""

from typing import Any

import numpy as np

from jaxclear.files.text import Node, misread

__all__ = ["as_float", "is_number", "nested", "plain_text"]


def is_number(node: Node) -> bool:
    """Whether a value is a number; a flag is none."""
    return isinstance(node.value, (int, float)) and not isinstance(node.value, bool)


def as_float(node: Node, path: str) -> float:
    """A number. Raises `Misread` for one beyond all that a computer holds."""
    try:
        return float(node.value)
    except OverflowError:
        raise misread(node, path, "is a number beyond all that a computer holds.") from None


def plain_text(node: Node, path: str) -> str:
    """A text; a number without quotes is one, too."""
    if isinstance(node.value, str):
        return node.value
    if node.raw is not None:
        return node.raw
    raise misread(node, path, f"is {node.said}; it must be a text.")


def nested(node: Node, path: str) -> Any:
    """Numbers in nested lists, all of one shape."""
    if is_number(node):
        return as_float(node, path)
    if not isinstance(node.value, list):
        raise misread(node, path, f"is {node.said}; it must be a list of numbers.")
    found = [nested(entry, path) for entry in node.value]
    if len({np.shape(entry) for entry in found}) > 1:
        raise misread(node, path, "is a list whose entries have different lengths.")
    return found
