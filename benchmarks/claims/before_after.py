"""Two checkouts side by side in one run: is anything slower than before?

    python -m benchmarks.claims.before_after --before FOLDER [--after FOLDER] [--only TEXT]
        [--scripts] [--quick] [--json FILE]

Three kinds of figures, all CPU time: the core figures of `core_figures` (each checkout in a
process of its own, the two taking turns call by call), the first result of a run in a new process,
and with `--scripts` the quick form of every benchmark, whose own times are compared. A figure's
ratio is the median over pairs (after divided by before), its spread half the distance of their
quartiles. What looks slower than the limit is measured again in new processes, longer; it counts
as slower where the median of all its pairs stays beyond the limit. Ends with status 1 if one does.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.measure import report

HERE = Path(__file__).resolve()
CORE = HERE.with_name("core_figures.py")
LIMIT = 1.05
# CPU seconds of one measurement of a pair, pairs of a figure, and how often a suspicious one is
# measured anew (with twice the pairs each time).
PORTION, PAIRS, AGAIN = 0.05, 15, 2
FIRST_RESULTS = ("FixedStep", "ImplicitStep", "Adaptive", "MoreauJean", "NonColliding")
FIRST = """
import time
import jaxclear as jc
jc.simulate(jc.scenes.four_bar(), 1e-3, integrator=jc.integrator.{rung}(), save=3)
print(time.process_time())
"""
# Scripts that had another name before they moved; others kept it.
OLD_NAMES = {
    "claims.equations": "trace",
    "claims.four_bar": "four_bar_run",
    "peers.slider_crank": "peers",
}
# Not a measure of time, or the measure itself.
LEFT_OUT = {"claims.before_after", "claims.house"}
UNITS = ("[s]", "[ms]", "[us]", "[ns]", "[ms/", "[us/", "[ns/", "CPU [", "ratio to the reference")


class Pairs(NamedTuple):
    """A figure's measurements [s], `before` and `after` in turn, or why there are none."""

    name: str
    before: list[float]
    after: list[float]
    trouble: str = ""

    @property
    def ratios(self) -> list[float]:
        return [b / a for a, b in zip(self.before, self.after, strict=True)]

    @property
    def ratio(self) -> float:
        return statistics.median(self.ratios)

    def row(self) -> dict[str, Any]:
        """A line of the table."""
        if self.trouble:
            return {"figure": self.name, "before [ms]": "-", "after [ms]": "-"} | {
                "ratio": "-",
                "spread": "-",
                "verdict": self.trouble,
            }
        lower, _, upper = statistics.quantiles(self.ratios, n=4)
        return {
            "figure": self.name,
            "before [ms]": 1e3 * statistics.median(self.before),
            "after [ms]": 1e3 * statistics.median(self.after),
            "ratio": self.ratio,
            "spread": (upper - lower) / 2,
            "verdict": "slower" if self.ratio > LIMIT else "",
        }


class Child:
    """A process that runs core figures under a checkout."""

    def __init__(self, folder: Path):
        self.process = subprocess.Popen(
            [sys.executable, "-P", str(CORE)],
            env=environment(folder),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def ask(self, request: str) -> Any:
        """The answer to one request; a sentence where it failed."""
        self.process.stdin.write(request + "\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        return json.loads(line) if line else "the process ended"

    def end(self) -> None:
        self.process.stdin.close()
        self.process.wait()


def environment(folder: Path, cached: bool = True) -> dict[str, str]:
    """Variables of a process that imports jaxclear from `folder`."""
    kept = {k: v for k, v in os.environ.items() if cached or k != "JAX_COMPILATION_CACHE_DIR"}
    return kept | {"PYTHONPATH": str(folder)}


def core_pairs(name: str, children: list[Child], pairs: int) -> Pairs:
    """A core figure measured in turn by both children."""
    estimates = [child.ask(f"prepare {name}") for child in children]
    trouble = [
        f"{which}: {answer}"
        for which, answer in zip(("before", "after"), estimates, strict=True)
        if isinstance(answer, str)
    ]
    if trouble:
        return Pairs(name, [], [], "; ".join(trouble))
    count = max(1, round(PORTION / max(*estimates, 1e-9)))
    times: list[list[float]] = [[], []]
    for turn in range(pairs):
        for i in (0, 1) if turn % 2 == 0 else (1, 0):
            times[i].append(children[i].ask(f"time {name}\t{count}") / count)
    return Pairs(name, *times)


def core_rows(folders: tuple[Path, Path], only: str, pairs: int) -> list[dict[str, Any]]:
    """Every core figure whose name holds `only`."""
    children = [Child(folder) for folder in folders]
    rows = []
    for name in children[1].ask("list"):
        if only in name:
            rows.append(settled(core_pairs(name, children, pairs), folders, pairs).row())
            print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    for child in children:
        child.end()
    return rows


def settled(found: Pairs, folders: tuple[Path, Path], pairs: int) -> Pairs:
    """A suspicious figure measured again in new processes, all pairs together: code that lies at
    another place in memory is a few per cent faster or slower."""
    for again in range(AGAIN):
        if found.trouble or found.ratio <= LIMIT:
            return found
        children = [Child(folder) for folder in folders]
        more = core_pairs(found.name, children, pairs * 2 ** (again + 1))
        found = Pairs(found.name, found.before + more.before, found.after + more.after)
        for child in children:
            child.end()
    return found


def first_result(rung: str, folders: tuple[Path, Path], pairs: int) -> Pairs:
    """CPU seconds of a new process up to its first result, without a cache of programs."""
    times: list[list[float]] = [[], []]
    for turn in range(pairs):
        for i in (0, 1) if turn % 2 == 0 else (1, 0):
            done = subprocess.run(
                [sys.executable, "-P", "-c", FIRST.format(rung=rung)],
                env=environment(folders[i], cached=False),
                capture_output=True,
                text=True,
            )
            if done.returncode != 0:
                sentence = done.stderr.strip().splitlines()[-1]
                return Pairs(
                    f"first result, {rung}", [], [], f"{('before', 'after')[i]}: {sentence}"
                )
            times[i].append(float(done.stdout))
    return Pairs(f"first result, {rung}", *times)


def first_rows(folders: tuple[Path, Path], only: str, pairs: int) -> list[dict[str, Any]]:
    """First results of every rung."""
    rows = []
    for rung in FIRST_RESULTS:
        if only in f"first result, {rung}":
            found = first_result(rung, folders, pairs)
            if not found.trouble and found.ratio > LIMIT:
                more = first_result(rung, folders, 2 * pairs)
                found = Pairs(found.name, found.before + more.before, found.after + more.after)
            rows.append(found.row())
            print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    return rows


def scripts(root: Path) -> list[str]:
    """Names of the benchmarks that can be run, as "claims.steps"."""
    files = sorted((root / "benchmarks").glob("*/*.py"))
    names = [f"{p.parent.name}.{p.stem}" for p in files if "__main__" in p.read_text()]
    return [name for name in names if name not in LEFT_OUT and name != f"claims.{CORE.stem}"]


def command(folder: Path, name: str) -> list[str] | None:
    """How a benchmark is started in a checkout: as a module, or as the file it once was."""
    room, stem = name.split(".")
    if (folder / "benchmarks" / room / f"{stem}.py").exists():
        return [sys.executable, "-m", f"benchmarks.{name}"]
    path = folder / "benchmarks" / f"{OLD_NAMES.get(name, stem)}.py"
    return [sys.executable, str(path)] if path.exists() else None


def script_times(folder: Path, name: str) -> dict[str, float] | str:
    """A benchmark's own times by the place at which they stand in its tables; a sentence where it
    failed."""
    start = command(folder, name)
    if start is None:
        return "there is no such benchmark"
    with tempfile.TemporaryDirectory() as place:
        answer = Path(place) / "figures.json"
        done = subprocess.run(
            [*start, "--quick", "--json", str(answer)],
            cwd=folder,
            env=environment(folder),
            capture_output=True,
            text=True,
        )
        if done.returncode != 0 or not answer.exists():
            return (done.stderr.strip().splitlines() or ["it wrote nothing"])[-1]
        tables = json.loads(answer.read_text())
    return {
        f"{name}, table {t + 1}, row {r + 1}, {key}": float(value)
        for t, rows in enumerate(tables.values())
        for r, row in enumerate(rows)
        for key, value in row.items()
        if isinstance(value, float) and any(unit in key for unit in UNITS)
    }


def script_rows(folders: tuple[Path, Path], only: str, pairs: int) -> list[dict[str, Any]]:
    """The times that the benchmarks print, of both checkouts in turn."""
    rows = []
    for name in scripts(folders[1]):
        if only not in name:
            continue
        found: list[list] = [[], []]
        for turn in range(pairs):
            for i in (0, 1) if turn % 2 == 0 else (1, 0):
                found[i].append(script_times(folders[i], name))
        failed = [str(times) for times in (*found[0], *found[1]) if isinstance(times, str)]
        if failed:
            rows.append(Pairs(name, [], [], failed[0]).row())
        else:
            for figure in found[1][0]:
                if all(figure in times for times in (*found[0], *found[1])):
                    sides = [[times[figure] for times in side] for side in found]
                    rows.append(Pairs(figure, *sides).row())
        print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    return rows


def main() -> None:
    """Prints the tables; ends with status 1 where something is slower."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--before", type=Path, required=True, help="the checkout to compare with")
    parser.add_argument("--after", type=Path, default=HERE.parents[2], help="this one by default")
    parser.add_argument("--only", default="", help="figures whose name holds this text")
    parser.add_argument("--scripts", action="store_true", help="also every benchmark's quick form")
    parser.add_argument("--quick", action="store_true", help="fewer pairs")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here")
    options = parser.parse_args()
    folders = options.before.resolve(), options.after.resolve()
    few = options.quick
    tables = {
        "before and after: core figures, CPU": core_rows(
            folders, options.only, 5 if few else PAIRS
        ),
        "before and after: first results, CPU": first_rows(folders, options.only, 2 if few else 3),
    }
    if options.scripts:
        tables["before and after: benchmarks"] = script_rows(folders, options.only, 2 if few else 3)
    slower = []
    for title, rows in tables.items():
        if rows:
            report(title, rows, options)
            slower += [row["figure"] for row in rows if row["verdict"] == "slower"]
    print(f"\nslower than before by more than {LIMIT - 1:.0%}: {', '.join(slower) or 'nothing'}")
    sys.exit(1 if slower else 0)


if __name__ == "__main__":
    main()
