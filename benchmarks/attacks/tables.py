"""What an attack has found, as tables: by rung, by response, told errors beside true ones, and what
is wrong without a sentence.
"""

import math
from collections import Counter
from typing import Any, NamedTuple

from benchmarks.attacks import verdicts
from benchmarks.attacks.answers import RESPONSES
from benchmarks.attacks.attempts import Finding
from benchmarks.attacks.verdicts import Verdict

# What a run may not be.
BAD = (Verdict.WRONG, Verdict.UNSAID, Verdict.RAW)
# What an answer of a run turns out to be, and between which shares of the true error a told one is
# told.
ANSWERED = (
    Verdict.RIGHT,
    "right, yet warned",
    Verdict.SAID,
    Verdict.UNDECIDABLE,
    Verdict.UNSAID,
    Verdict.WRONG,
)
TOLD = (0.5, 10.0)


class Row(NamedTuple):
    """One run of one case: what was found, and CPU seconds."""

    case: int
    mechanism: str
    rung: str
    integrator: str
    found: Finding
    seconds: float

    @property
    def verdict(self) -> Verdict:
        """The verdict on the run."""
        return self.found.verdict


def summary(rows: list[Row]) -> list[dict[str, Any]]:
    """Runs by rung and verdict, with the share of right ones that carry a warning."""
    table = []
    for rung in [*dict.fromkeys(row.rung for row in rows), "all"]:
        own = [row for row in rows if rung in (row.rung, "all")]
        counts = Counter(row.verdict for row in own)
        right = [row for row in own if row.verdict == Verdict.RIGHT]
        warned = sum(bool(row.found.warned) for row in right)
        table.append(
            {"rung": rung, "runs": len(own)}
            | {str(verdict): counts[verdict] for verdict in Verdict}
            | {"right, yet warned [%]": 100.0 * warned / max(len(right), 1)}
        )
    return table


def by_response(rows: list[Row]) -> list[dict[str, Any]]:
    """Responses by verdict."""
    return [
        {"response": name}
        | {
            str(verdict): sum(row.found.verdicts.get(name) == verdict for row in rows)
            for verdict in Verdict
        }
        for name in RESPONSES
    ]


def by_answer(rows: list[Row]) -> list[dict[str, Any]]:
    """Answers by rung and verdict, right ones parted by whether they are warned of."""
    table = []
    for rung in [*dict.fromkeys(row.rung for row in rows), "all"]:
        counts = Counter(
            "right, yet warned"
            if verdict == Verdict.RIGHT and name in row.found.warned
            else verdict
            for row in rows
            if rung in (row.rung, "all")
            for name, verdict in row.found.verdicts.items()
        )
        table.append(
            {"rung": rung, "answers": counts.total()}
            | {str(each): counts[each] for each in ANSWERED}
        )
    return table


def told_beside_true(rows: list[Row]) -> list[dict[str, Any]]:
    """By rung and by response, of answers whose error is decided and beyond a tenth of what is
    promised, how many runs tell it as too small, as it is, and as too large."""
    found = [
        (row.rung, name, row.found.told[name] / error)
        for row in rows
        for name, error in row.found.errors.items()
        if name in row.found.told and _counts(row.found, name)
    ]
    table = []
    for label in [*dict.fromkeys(rung for rung, _, _ in found), *RESPONSES, "all"]:
        own = [ratio for rung, name, ratio in found if label in (rung, name, "all")]
        if own:
            small, large = (sum(x < TOLD[0] for x in own), sum(not x <= TOLD[1] for x in own))
            within = 100.0 * (len(own) - small - large) / len(own)
            row = {"of": label, "answers": len(own), "told too small": small}
            table.append(row | {"told too large": large, "told [%]": within})
    return table


def _counts(found: Finding, name: str) -> bool:
    limit, error = found.limits[name], found.errors[name]
    known = limit is not None and math.isfinite(error)
    return known and error > limit / 10 and found.between[name] <= verdicts.DECISIVE * error


def accused(rows: list[Row]) -> list[dict[str, Any]]:
    """The runs whose numbers are wrong without a sentence, and those that broke."""
    return [
        {
            "case": row.case,
            "mechanism": row.mechanism,
            "integrator": row.integrator,
            "verdict": str(row.verdict),
            "off by": _off(row.found) or " ".join(row.found.said)[:100],
        }
        for row in rows
        if row.verdict in BAD
    ]


def _off(found: Finding) -> str:
    return ", ".join(
        f"{name} {found.errors[name]:.2g}"
        + (f" (+-{found.doubts[name]:.1g})" if name != "drift" else "")
        for name, verdict in found.verdicts.items()
        if verdict in BAD
    )


def tables(rows: list[Row]) -> dict[str, list[dict[str, Any]]]:
    """What is printed and written, by title."""
    mechanisms = len({row.mechanism for row in rows})
    found = {
        "accuracy that a silent run is held to": verdicts.stated(),
        f"runs by rung, {mechanisms} mechanisms": summary(rows),
        f"answers by response, {mechanisms} mechanisms": by_response(rows),
        f"answers by rung, {mechanisms} mechanisms": by_answer(rows),
        "told beside true": told_beside_true(rows),
    }
    return found | ({"wrong without a sentence": accused(rows)} if accused(rows) else {})
