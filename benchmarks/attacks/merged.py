"""The tables of several attacks, of other draws each, as those of one.

    python -m benchmarks.attacks.merged FILE FILE ... --json FILE

Counts are added; shares are those of all runs that they are shares of; runs that are wrong without
a sentence follow each other. Commands and dates are listed.
"""

import argparse
import json
from pathlib import Path
from typing import Any

# Shares, and of which count each is one.
SHARES = {"right, yet warned [%]": "right", "told [%]": "answers"}
# Tables that hold what all runs are judged by, alike in every file, and single runs.
RULES, RUNS = "accuracy that a silent run is held to", "wrong without a sentence"
Table = list[dict[str, Any]]


def added(tables: list[Table]) -> Table:
    """Tables of counts as one: by what their rows begin with, in the order in which they come."""
    label = next(iter(tables[0][0]))
    found: dict[str, dict[str, Any]] = {}
    for row in (row for table in tables for row in table):
        own = found.setdefault(row[label], {label: row[label]})
        for share, of in SHARES.items():
            if share in row:
                counted = own.get(share, 0.0) * own.get(of, 0) + row[share] * row[of]
                own[share] = counted / max(own.get(of, 0) + row[of], 1)
        for name, count in row.items():
            if name != label and name not in SHARES:
                own[name] = own.get(name, 0) + count
    order = list(tables[0][0])
    rows = [{name: row[name] for name in order} for row in found.values()]
    return sorted(rows, key=lambda row: row[label] == "all")


def merged(files: list[dict[str, Any]]) -> dict[str, Any]:
    """The documents of attacks as one."""
    first = files[0]
    if any(other[RULES] != first[RULES] for other in files):
        raise ValueError("the attacks hold runs to accuracies of their own; measure them anew.")
    listed = lambda key: "; ".join(file["about"][key] for file in files)
    told: dict[str, Any] = {
        "about": first["about"] | {"command": listed("command"), "date": listed("date")},
        RULES: first[RULES],
    }
    for title in first:
        if title not in ("about", RULES, RUNS):
            told[title] = added([file[title] for file in files])
    accused = [row for file in files for row in file.get(RUNS, [])]
    return told | ({RUNS: accused} if accused else {})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE", help="results of attacks")
    parser.add_argument("--json", type=Path, required=True, metavar="FILE", help="write them here")
    options = parser.parse_args()
    found = merged([json.loads(file.read_text()) for file in options.files])
    options.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
