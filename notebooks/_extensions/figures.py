"""Kernels look at every figure before a page shows it, and note on stderr which texts collide.

Pages do not show that; `benchmarks.claims.book` counts it.
"""

import os
from pathlib import Path

from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]
# What a kernel runs as it starts. Pages show figures without margins, so that no text leaves them.
STARTUP = f"""
import functools
import sys

from matplotlib.backend_bases import FigureCanvasBase


def looking(print_figure):
    @functools.wraps(print_figure)
    def look(canvas, *args, **settings):
        from benchmarks.figures_text import colliding

        for sentence in colliding(canvas.figure):
            if "upon" in sentence:
                print(f"figure:1: CollidingText: {{sentence}}", file=sys.stderr)
        return print_figure(canvas, *args, **settings)

    return look


sys.path.append({str(ROOT)!r})
FigureCanvasBase.print_figure = looking(FigureCanvasBase.print_figure)
del looking
"""


def setup(app: Sphinx) -> dict:
    if not (ROOT / "benchmarks" / "figures_text.py").exists():
        return {"parallel_read_safe": True, "parallel_write_safe": True}
    folder = ROOT / "build" / "ipython"
    startup = folder / "profile_default" / "startup"
    startup.mkdir(parents=True, exist_ok=True)
    (startup / "figures.py").write_text(STARTUP)
    os.environ["IPYTHONDIR"] = str(folder)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
