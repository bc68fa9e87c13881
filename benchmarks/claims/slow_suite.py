"""What the slow tests take, or the fast ones, and whether they pass: CPU time of each file, and its
longest test.

`python -m benchmarks.claims.slow_suite --paths tests/laws tests/mesh --json
benchmarks/results/slow_suite.json` runs these and renews their rows; a file is written as soon as
it is through, so a run may be ended at any time. `--most 2` runs two tests at most of each
parametrised function, evenly spread over its parameters; "of" is how many slow tests a file has.
`--fast` runs the fast tests in their place, for benchmarks/results/fast_suite.json.
"""

import json
import os
from pathlib import Path
from typing import Any

import pytest

from benchmarks.measure import arguments, report, sign


class Durations:
    """A plugin of pytest that adds up CPU time by file and reports a file after its last test."""

    def __init__(self, options: Any) -> None:
        self.options = options
        self.tests: dict[str, dict[str, float]] = {}
        self.failed: dict[str, list[str]] = {}
        self.skipped: dict[str, int] = {}
        self.chosen_tests: dict[str, int] = {}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        functions: dict[str, list[pytest.Item]] = {}
        for item in items:
            if (item.get_closest_marker("slow") is None) == self.options.fast:
                file = item.nodeid.partition("::")[0]
                self.chosen_tests[file] = self.chosen_tests.get(file, 0) + 1
                functions.setdefault(item.nodeid.partition("[")[0], []).append(item)
        if self.options.most is not None:
            chosen = {item for group in functions.values() for item in self.spread(group)}
            items[:] = [item for item in items if item in chosen]

    def spread(self, group: list[pytest.Item]) -> list[pytest.Item]:
        """As many of a group as are asked for, evenly spread."""
        count = min(self.options.most, len(group))
        return [group[round(k * (len(group) - 1) / max(count - 1, 1))] for k in range(count)]

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> Any:
        file, _, name = item.nodeid.partition("::")
        start = sum(os.times()[:4])
        try:
            return (yield)
        finally:
            self.tests.setdefault(file, {})[name] = sum(os.times()[:4]) - start
            if nextitem is None or nextitem.nodeid.partition("::")[0] != file:
                self.report_file(file)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        file, _, name = report.nodeid.partition("::")
        if report.failed:
            self.failed.setdefault(file, []).append(name)
        self.skipped[file] = self.skipped.get(file, 0) + report.skipped

    def report_file(self, file: str) -> None:
        spent = self.tests[file]
        longest = max(spent, key=spent.__getitem__)
        row = {
            "file": Path(file).name,
            "tests": len(spent),
            "of": self.chosen_tests[file],
            "failed": len(self.failed.get(file, [])),
            "skipped": self.skipped.get(file, 0),
            "CPU [s]": round(sum(spent.values()), 1),
            "longest [s]": round(spent[longest], 1),
            "longest": longest,
            "failing": ", ".join(self.failed.get(file, [])),
        }
        folder, path = str(Path(file).parent), self.options.json
        known = json.loads(path.read_text()) if path is not None and path.exists() else {}
        others = [old for old in known.get(folder, []) if old["file"] != row["file"]]
        report(folder, [*others, row], self.options)
        sign("benchmarks.claims.slow_suite", path, (folder,))


def main() -> None:
    options = arguments(
        __doc__ or "",
        paths={"nargs": "+", "default": ["tests"], "help": "files and folders of tests"},
        fast={"action": "store_true", "help": "the fast tests in the place of the slow ones"},
        most={"type": int, "help": "so many tests at most of a parametrised function"},
    )
    paths = options.paths[:1] if options.quick else options.paths
    kind = "not slow" if options.fast else "slow"
    with_options = ["-m", kind, "-q", "-p", "no:cacheprovider", *map(str, map(Path, paths))]
    raise SystemExit(pytest.main(with_options, plugins=[Durations(options)]))


if __name__ == "__main__":
    main()
