"""A shared library of a unit, for this machine or another one, by the C compiler that is found here
or else by the package `ziglang`.
"""

import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from jaxclear.ground.arguments import check_name


class Target(NamedTuple):
    """A system by FMI's name: by LLVM's and Zig's, the end of a library's name, and the processors
    for which code may be written, the usual one first."""

    triple: str
    zig: str
    ending: str
    cpus: tuple[str, ...]


X86 = ("x86-64-v3", "x86-64", "x86-64-v2", "x86-64-v4")
TARGETS = {
    "x86_64-linux": Target("x86_64-unknown-linux-gnu", "x86_64-linux-gnu", "so", X86),
    "aarch64-linux": Target("aarch64-unknown-linux-gnu", "aarch64-linux-gnu", "so", ("generic",)),
    "x86_64-windows": Target("x86_64-w64-windows-gnu", "x86_64-windows-gnu", "dll", X86),
    "x86_64-darwin": Target("x86_64-apple-macosx11.0", "x86_64-macos", "dylib", X86),
    "aarch64-darwin": Target("arm64-apple-macosx11.0", "aarch64-macos", "dylib", ("apple-m1",)),
}
NO_COMPILER = (
    'an FMU for {target} needs a C compiler here: python -m pip install "jaxclear[fmu]" installs '
    "one (ziglang{others})."
)


def this_machine() -> str:
    """FMI's name of this system."""
    machine = {"AMD64": "x86_64", "arm64": "aarch64"}.get(platform.machine(), platform.machine())
    return f"{machine}-{platform.system().lower()}"


def checked_target(target: str | None) -> str:
    """A system for which units are made, by default this one. Raises `ValueError`."""
    name = this_machine() if target is None else target
    check_name("target", name, TARGETS, " of export_fmu")
    return name


def find_compiler(target: str) -> list[str]:
    """The command that compiles and links for a target. Raises `ImportError` with a sentence."""
    if target == this_machine():
        for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
            if name and shutil.which(name):
                return [name]
    if importlib.util.find_spec("ziglang") is None:
        others = ", or install one of your system" if target == this_machine() else ""
        raise ImportError(NO_COMPILER.format(target=target, others=others))
    return [sys.executable, "-m", "ziglang", "cc", "-target", TARGETS[target].zig]


def link_library(command: list[str], header: str, code: bytes) -> bytes:
    """Bytes of a unit's shared library.

    Args:
        command: of the C compiler, with its first arguments.
        header: text of the unit's C header.
        code: object file of its functions.

    Raises:
        RuntimeError: the compiler fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "unit.h").write_text(header, encoding="utf-8")
        (place / "unit.o").write_bytes(code)
        source = (Path(__file__).parent / "fmi3.c").read_text(encoding="utf-8")
        (place / "fmi3.c").write_text(source, encoding="utf-8")
        out = place / "unit.library"
        options = ["-O2", "-shared", "-fPIC", "-fvisibility=hidden", "-s", "-w"]
        files = ["fmi3.c", "unit.o", "-lm", "-o", out.name]
        done = subprocess.run(
            [*command, *options, *files], cwd=place, capture_output=True, text=True, check=False
        )
        if done.returncode or not out.exists():
            raise RuntimeError(f"{' '.join(command)} could not make the FMU: {done.stderr[-2000:]}")
        return out.read_bytes()
