"""A file that keeps what was judged, a line of JSON for every case, so that a benchmark that is
stopped goes on where it was.
"""

import json
from pathlib import Path
from typing import Any

from benchmarks.attacks.attempts import Finding
from benchmarks.attacks.verdicts import Verdict

# What earlier files do not have.
LATER = ("told", "limits", "between")


def keep(path: Path | None, key: str, rows: list[Any]) -> None:
    """Add the rows of a case, named tuples with what was `found`, to the file, if there is one."""
    if path is not None:
        own = [row._asdict() | {"found": _plain(row.found)} for row in rows]
        with path.open("a") as file:
            file.write(json.dumps({"key": key, "rows": own}) + "\n")


def known(path: Path | None, kind: Any) -> dict[str, list[Any]]:
    """Rows of that kind by case, of a file; none where there is no file."""
    if path is None or not path.exists():
        return {}
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    return {
        line["key"]: [kind(**row | {"found": _found(row["found"])}) for row in line["rows"]]
        for line in lines
    }


def _plain(found: Finding) -> dict[str, Any]:
    parts = {name: dict(getattr(found, name)) for name in LATER}
    return found._asdict() | {"warned": sorted(found.warned)} | parts


def _found(plain: dict[str, Any]) -> Finding:
    return Finding(
        Verdict(plain["verdict"]),
        {name: Verdict(verdict) for name, verdict in plain["verdicts"].items()},
        plain["errors"],
        plain["doubts"],
        tuple(plain["said"]),
        frozenset(plain["warned"]),
        *(plain.get(name, {}) for name in LATER),
    )
