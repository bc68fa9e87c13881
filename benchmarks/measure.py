"""How the benchmarks measure: side by side, the smallest of several, and never across processes.

Wall time is what a user waits for; CPU time is what the work costs, and the one to compare on a
machine that is shared.
"""

import argparse
import datetime
import json
import logging
import math
import os
import platform
import shlex
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax


def arguments(description: str, **more: dict[str, Any]) -> argparse.Namespace:
    """`--quick` for small sizes, `--json FILE` for the printed figures as JSON; `more` by name."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="small sizes, mostly within a minute")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here")
    for name, how in more.items():
        parser.add_argument(f"--{name}", **how)
    return parser.parse_args()


def run_tables(tables: dict[str, Callable[[argparse.Namespace], Any]], **more: Any) -> None:
    """The frame of a benchmark: computes the rows of each table from the options, prints them and
    writes them under its title, with the call that measured them. `--only TEXT`: tables whose title
    holds it; `more`: options of the benchmark."""
    program: Any = sys.modules["__main__"]
    only = {"default": "", "metavar": "TEXT", "help": "only tables whose title holds this"}
    options, titles = arguments(program.__doc__, only=only, **more), []
    for title, rows_of in tables.items():
        if options.only in title:
            titles.append(title)
            report(title, list(rows_of(options)), options)
            sign(program.__spec__.name, options.json, titles)


def stored_rows(title: str, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Rows that an earlier call wrote under a title."""
    path = options.json
    return json.loads(path.read_text()).get(title, []) if path and path.exists() else []


def side_by_side(
    cases: dict[str, Callable[[], Any]], repeats: int = 5
) -> dict[str, tuple[float, float]]:
    """Smallest (wall, CPU) seconds of each case, the cases taking turns; each runs once before."""
    best = {name: (float("inf"), float("inf")) for name in cases}
    for case in cases.values():
        jax.block_until_ready(case())
    for _ in range(repeats):
        for name, case in cases.items():
            cpu, wall = time.process_time(), time.perf_counter()
            jax.block_until_ready(case())
            spent = time.perf_counter() - wall, time.process_time() - cpu
            best[name] = tuple(map(min, best[name], spent))
    return best


def by_turns(
    cases: dict[str, Callable[[], Any]], beside: str, seconds: float, most: int = 25
) -> tuple[float, dict[str, float], int]:
    """(median CPU seconds of the case `beside`, the median over turns of every other case's CPU
    time over it in the same turn, how many turns): for machines that others load. Each runs once
    before; at least 5 turns, and then no more than fill so many `seconds` of CPU time."""
    for case in cases.values():
        jax.block_until_ready(case())
    spent: dict[str, list[float]] = {name: [] for name in cases}
    begun, turns = time.process_time(), 0
    while turns < 5 or (turns < most and time.process_time() - begun < seconds):
        for name, case in cases.items():
            start = time.process_time()
            jax.block_until_ready(case())
            spent[name].append(time.process_time() - start)
        turns += 1
    ratios = {
        name: statistics.median(a / b for a, b in zip(own, spent[beside], strict=True))
        for name, own in spent.items()
        if name != beside
    }
    return statistics.median(spent[beside]), ratios, turns


@contextmanager
def loop_reasons() -> Iterator[list[str]]:
    """Why loops that are compiled within are left to XLA."""
    messages: list[str] = []
    log, handler = logging.getLogger("jaxclear.native.loop"), logging.Handler(logging.INFO)
    handler.emit = lambda record: messages.append(record.getMessage())
    level = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield messages
    finally:
        log.removeHandler(handler)
        log.setLevel(level)


def seconds_to_compile(function: Callable, *args: Any) -> tuple[Any, float]:
    """(compiled program, CPU seconds to trace, lower and compile it); never from a cache."""
    start = time.process_time()
    compiled = jax.jit(lambda *a: function(*a)).lower(*args).compile()
    return compiled, time.process_time() - start


def report(title: str, rows: list[dict[str, Any]], options: argparse.Namespace) -> None:
    """Print the rows as a table and write them where asked."""
    print(f"\n{title}")
    names = list(rows[0])
    cells = [[_text(row[name]) for name in names] for row in rows]
    widths = [max(len(name), *(len(line[i]) for line in cells)) for i, name in enumerate(names)]
    for line in [names, *cells]:
        print(
            "  ".join(
                text.ljust(w) if i == 0 else text.rjust(w)
                for i, (text, w) in enumerate(zip(line, widths, strict=False))
            )
        )
    if options.json is not None:
        known = json.loads(options.json.read_text()) if options.json.exists() else {}
        options.json.write_text(in_json(known | {title: rows}))


def in_json(document: Any) -> str:
    """Results as the text of a file. JSON has no word for infinite and for what is no number: these
    are null."""
    return json.dumps(_told(document), indent=1, allow_nan=False) + "\n"


def _told(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _told(own) for name, own in value.items()}
    if isinstance(value, (list, tuple)):
        return [_told(own) for own in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def about(module: str, path: Path | None, parts: Sequence[str] = ()) -> dict[str, Any]:
    """Which command measured, where, when and on which commit; the machine as the file at `path`
    names it, if it does. `parts`: the titles (or how they begin) that this call measured, where
    others of the file come from calls of their own; each keeps its own command and date, that of a
    call for everything stands for all of them."""
    known = json.loads(path.read_text()) if path is not None and path.exists() else {}
    before = known.get("about", {})
    here = f"{os.cpu_count()} cores ({platform.machine()})"
    asked = list(sys.argv[1:])
    if "--json" in asked:  # where figures are written, not what is measured
        at = asked.index("--json")
        del asked[at : at + 2]
    command = " ".join(["python -m", module, *map(shlex.quote, asked)])
    today = date()
    told: dict[str, Any] = {
        "command": f"python -m {module}" if parts else command,
        "machine": before.get("machine", here),
        "date": today,
    }
    if parts and asked:
        own = {part: {"command": command, "date": today} for part in parts}
        whole = {key: before.get(key) for key in ("command", "date")}
        first = {"": whole} if whole["command"] == told["command"] else {}
        told["parts"] = before.get("parts", first) | own
    return told


def sign(module: str, path: Path | None, parts: Sequence[str] = ()) -> None:
    """Says in a file of results, first of all, where they come from (see `about`)."""
    if path is not None:
        told = {"about": about(module, path, parts)}
        path.write_text(in_json(told | json.loads(path.read_text()) | told))


def date() -> str:
    """Today, and the commit that is measured, where git tells it."""
    asked = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short", "HEAD"]
    try:
        commit = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return datetime.date.today().isoformat()
    return f"{datetime.date.today().isoformat()}, commit {commit}"


def _text(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
