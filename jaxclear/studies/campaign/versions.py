"""Which programs computed a chunk: their versions, as a text and as a number that marks it."""

import hashlib
import json
import platform
from importlib import metadata

import jax
import numpy as np

__all__ = ["change", "mark_of", "told_versions"]

LIBRARIES = ("jaxclear", "jax", "jaxlib", "numpy", "scipy", "xarray", "zarr")


def told_versions() -> dict[str, str]:
    """Name and version of what computes here: libraries, Python, the kind of device."""
    found = {"python": platform.python_version()}
    for library in LIBRARIES:
        try:
            found[library] = metadata.version(library)
        except metadata.PackageNotFoundError:
            found[library] = "unknown"
    device = jax.devices()[0]
    kind = platform.machine() if device.platform == "cpu" else device.device_kind
    return found | {"device": f"{device.platform} ({kind})"}


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
