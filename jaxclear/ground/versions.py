"""Which programs compute here: what numbers are kept with, so that they can be had again."""

import platform
from importlib import metadata

import jax

__all__ = ["installed", "told_versions"]

LIBRARIES = ("jaxclear", "jax", "jaxlib", "numpy", "scipy", "xarray", "zarr")


def told_versions() -> dict[str, str]:
    """Name and version of what computes here: libraries, Python, the kind of device."""
    found = {"python": platform.python_version()}
    found |= {library: installed(library) for library in LIBRARIES}
    device = jax.devices()[0]
    kind = platform.machine() if device.platform == "cpu" else device.device_kind
    return found | {"device": f"{device.platform} ({kind})"}


def installed(library: str) -> str:
    """The version of a library that is installed here; "unknown" of one that is not."""
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return "unknown"
