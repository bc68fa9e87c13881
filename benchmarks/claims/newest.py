"""The newest JAX on the newest Python: does the package install there, and do its tests pass?

`python -m benchmarks.claims.newest --json benchmarks/results/newest.json` takes the newest
`python3.N` of the path and of pyenv; pip chooses the newest versions that the package's bounds
allow, in an environment in build/newest, and the tests of `--paths` run there.
"""

import os
import re
import subprocess
from pathlib import Path
from typing import Any

from benchmarks.measure import run_tables

ENVIRONMENT = Path("build/newest")
PATHS = ["tests/native/test_rules.py", "tests/native/test_derivative_rules.py"]
VERSIONS = "import sys, jax; print(sys.version.split()[0], jax.__version__)"


def newest_python() -> Path:
    """The interpreter of the highest version that is installed."""
    folders = [*Path.home().glob(".pyenv/versions/*/bin"), *os.environ["PATH"].split(os.pathsep)]
    found = [path for folder in folders for path in Path(folder).glob("python3.*[0-9]")]
    return max(found, key=lambda path: int(path.name.partition(".")[2]))


def rows(options: Any) -> list[dict[str, Any]]:
    """One row: versions, and what came of the tests."""
    python = ENVIRONMENT / "bin" / "python"
    subprocess.run([newest_python(), "-m", "venv", ENVIRONMENT], check=True)
    wanted = [".[mesh]", "hypothesis", "pytest", "pytest-xdist"]
    subprocess.run([python, "-m", "pip", "install", "-qU", *wanted], check=True)
    output = lambda *call: subprocess.run([python, *call], stdout=-1, stderr=-2, text=True).stdout
    versions = dict(zip(("Python", "JAX"), output("-c", VERSIONS).split(), strict=True))
    said = output("-m", "pytest", "-n", "0", "-m", "", "--capture=sys", *options.paths)
    found = {kind: re.search(rf"(\d+) {kind}", said) for kind in ("passed", "failed", "skipped")}
    counts = {kind: int(count[1]) if count else 0 for kind, count in found.items()}
    if not counts["passed"]:
        raise SystemExit(said)
    failing = ", ".join(re.findall(r"^FAILED (\S+)", said, re.MULTILINE)[:9])
    return [versions | {"tests": " ".join(options.paths)} | counts | {"failing": failing}]


if __name__ == "__main__":
    paths = {"nargs": "+", "default": PATHS, "help": "files and folders of tests"}
    run_tables({"The newest JAX on the newest Python": rows}, paths=paths)
