"""Measurements behind every number that the documents give.

`claims` measures the engine itself, `peers` sets it beside other programs, `by_hand` beside the
same mechanisms written by hand. From the root of the repository:

    python -m benchmarks.claims.scaling [--quick] [--json FILE]

`--json` writes {title: [rows]}, a row being {name of the figure [unit]: value}.

Nothing that is compiled is kept for another process, but where that is what is measured.
"""

import os

os.environ["JAXCLEAR_CACHE"] = "0"
