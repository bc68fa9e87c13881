"""Which programs computed a chunk: their versions, as a text and as a number that marks it."""

import hashlib
import json
import secrets
from pathlib import Path

import numpy as np

from jaxclear.ground.datasets import told_versions

__all__ = ["change", "mark_of", "signed", "signers", "told_versions"]


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


def signed(place: Path, now: dict[str, str]) -> int:
    """The mark of these versions, which the folder then knows."""
    place.mkdir(exist_ok=True)
    beside = place / f".{secrets.token_hex(8)}"
    beside.write_text(json.dumps(now, indent=1, sort_keys=True))
    beside.replace(place / f"{mark_of(now):x}.json")
    return mark_of(now)


def signers(place: Path) -> dict[int, dict[str, str]]:
    """The versions that a folder knows, by their mark."""
    texts = [path.read_text() for path in sorted(place.glob("*.json"))]
    return {mark_of(own): own for own in map(json.loads, texts)}
