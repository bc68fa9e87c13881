"""How the book is built: `python -m sphinx -j 2 -W --keep-going notebooks build/book`.

Nothing is fetched from a network, neither when the book is built nor when it is read. The cells of
the notebooks run in the build; what has not changed is taken from the cache beside it.
"""

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_extensions"))
# Programs that the cells compile are kept between builds by JAX alone, small ones too: a design has
# a hundred.
os.environ.setdefault("JAXCLEAR_CACHE", "0")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(HERE.parent / "build" / "compiled_programs"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")

project = "jaxclear"
author = "the authors of jaxclear"
extensions = [
    "myst_nb",
    "fold",
    "offline_math",
    "measured",
    "reference",
    "terms",
    "timed",
    "figures",
]
exclude_patterns = ["_extensions", "**.ipynb_checkpoints"]
master_doc = "index"

html_theme = "furo"
html_title = "jaxclear"
html_static_path = ["_static"]
html_css_files = ["book.css"]
html_math_renderer = "mathml"

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
# One argument a line, and types under the names by which one reaches them.
python_maximum_signature_line_length = 60
python_use_unqualified_type_names = True
nb_execution_mode = "cache"
nb_execution_timeout = 1200
nb_execution_raise_on_error = True
nb_execution_show_tb = True
# Sliders of a notebook need a kernel; their scripts would be fetched from a network.
nb_ipywidgets_js = {}
# Progress bars and compilers write there.
nb_output_stderr = "remove"
# What a cell prints in pieces is one block.
nb_merge_streams = True
