"""Scene files: what it costs to write and read the package's scenes, beside building them in
Python; accelerations of public robots from URDF beside MuJoCo's; and what becomes of mutated files.
"""

import tempfile
import time
from pathlib import Path

import equinox as eqx

import jaxclear as jc
from benchmarks.measure import arguments, report, side_by_side, sign
from jaxclear.files.scene import scene_text
from tests.files.test_malformed_files import run_mutations
from tests.files.test_model_import import PUBLIC
from tests.rigs.mujoco_trees import ROBOTS, largest_difference

MUTATED = 10_000


def sizes_and_times(folder: Path) -> list[dict]:
    """Of every ready scene, as YAML and JSON; all are read again leaf by leaf."""
    rows = []
    for name in jc.scenes.__all__:
        build = getattr(jc.scenes, name)
        mechanism = build()
        for ending in (".yaml", ".json"):
            path = folder / f"{name}{ending}"
            jc.write_scene(mechanism, path)
            same = eqx.tree_equal(jc.read_scene(path).mechanism, mechanism)
            found = side_by_side(
                {
                    "build": lambda build=build: build() and None,
                    "write": lambda m=mechanism, e=ending: scene_text(jc.Scene(m), e) and None,
                    "read": lambda path=path: jc.read_scene(path) and None,
                }
            )
            rows.append(
                {
                    "scene": f"{name}{ending}",
                    "bytes": path.stat().st_size,
                    "write [CPU ms]": 1e3 * found["write"][1],
                    "read [CPU ms]": 1e3 * found["read"][1],
                    "read / build in Python": found["read"][1] / found["build"][1],
                    "the same leaf by leaf": bool(same),
                }
            )
    return rows


def differences(models: dict[str, bool]) -> list[dict]:
    rows = []
    for name, floating in models.items():
        worst, count = largest_difference(ROBOTS / name, floating=floating)
        rows.append(
            {
                "model": name.rpartition("/")[2],
                "root": "floating" if floating else "fixed",
                "speeds": count,
                "largest difference / largest acceleration": worst,
            }
        )
    return rows


def main() -> None:
    options = arguments(__doc__)
    with tempfile.TemporaryDirectory() as folder:
        report("Scene files: size and time", sizes_and_times(Path(folder)), options)
        count = 300 if options.quick else MUTATED
        begun = time.process_time()
        verdicts, longest = run_mutations(Path(folder), count, first=1000)
        spent = time.process_time() - begun
    row = {"files": count, "read as a scene": verdicts["read"]}
    row |= {"refused with a sentence": verdicts["refused"], "anything else": 0}
    row |= {"longest [CPU s]": longest, "mean [CPU ms]": 1e3 * spent / count}
    row["anything else"] = count - sum(verdicts.values())
    report("Scene files: mutated files", [row], options)
    models = dict(list(PUBLIC.items())[:1]) if options.quick else PUBLIC
    report("Scene files: accelerations beside MuJoCo's", differences(models), options)
    sign("benchmarks.claims.scene_files", options.json)


if __name__ == "__main__":
    main()
