"""What a build takes, in `build.json` beside the pages: seconds, CPU seconds of it and its kernels,
and the seconds in which the cells of each page ran, in this build or in that whose outputs it took
from the cache.
"""

import json
import resource
import time
from pathlib import Path

from myst_nb.sphinx_ import NbMetadataCollector
from sphinx.application import Sphinx


def cpu() -> float:
    """CPU seconds of this process and of its children that have ended."""
    every = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(spent.ru_utime + spent.ru_stime for spent in every)


def write(app: Sphinx, exception: Exception | None) -> None:
    ran = {name: NbMetadataCollector.get_exec_data(app.env, name) for name in app.env.found_docs}
    told = {
        "seconds": round(time.monotonic() - app.begun, 1),
        "CPU seconds": round(cpu(), 1),
        "pages": {name: round(data["runtime"], 1) for name, data in sorted(ran.items()) if data},
    }
    (Path(app.outdir) / "build.json").write_text(json.dumps(told, indent=1) + "\n")


def setup(app: Sphinx) -> dict:
    app.begun = time.monotonic()
    app.connect("build-finished", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
