"""Which programs computed a chunk: their versions, as a text and as a number that marks it."""

import hashlib
import json

import numpy as np

from jaxclear.ground.versions import told_versions

__all__ = ["change", "mark_of", "told_versions"]


def mark_of(versions: dict[str, str]) -> int:
    """A number for these versions, which marks the chunks that they computed; never 0."""
    said = json.dumps(versions, sort_keys=True).encode()
    found = np.frombuffer(hashlib.sha256(said).digest()[:8], np.int64)[0]
    return int(found) or 1


def change(before: dict[str, str], now: dict[str, str]) -> str:
    """What differs between two versions, in words; "" for nothing."""
    names = [name for name in {**before, **now} if before.get(name) != now.get(name)]
    return ", ".join(
        f"{n} {before.get(n, 'absent')} then, {now.get(n, 'absent')} now" for n in names
    )
