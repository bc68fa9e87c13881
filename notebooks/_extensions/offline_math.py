"""Mathematics as MathML: browsers draw it by themselves.

MathJax would be fetched from a network when a page is read, and pictures would need LaTeX when it
is built. MathML needs neither. docutils, which Sphinx stands on, brings the translator.
"""

import re
from html import unescape
from xml.etree import ElementTree

from docutils import nodes
from docutils.utils.math import MathError, latex2mathml, pick_math_environment
from sphinx.application import Sphinx
from sphinx.util import logging

LOG = logging.getLogger(__name__)
# docutils does not know these; they mean the same.
SHORT_FRACTION = re.compile(r"\\frac\s*(\d)(\d)")
# Those of HTML, such as &nbsp;, which XML does not know.
ENTITY = re.compile(r"&(?!(?:lt|gt|amp|quot|apos);)\w+;")
MATHML = "http://www.w3.org/1998/Math/MathML"
ElementTree.register_namespace("", MATHML)
SYNONYMS = {r"\operatorname*": r"\operatorname", r"\tfrac": r"\frac", r"\dfrac": r"\frac"}


def mathml(tex: str, display: bool) -> str:
    """MathML of a TeX formula; lines parted by a double backslash are aligned at &."""
    for unknown, known in SYNONYMS.items():
        tex = tex.replace(unknown, known)
    tex = SHORT_FRACTION.sub(r"\\frac{\1}{\2}", tex)
    if display and "\\begin" not in tex and ("\\\\" in tex or "&" in tex):
        environment = pick_math_environment(tex)
        tex = f"\\begin{{{environment}}}{tex}\\end{{{environment}}}"
    return beside(latex2mathml.tex2mathml(tex, as_block=display))


def beside(formula: str) -> str:
    """A formula whose subscripts stand beside the letters: docutils sets that of a letter with an
    accent under it, as limits are set under a sum.
    """
    tree = ElementTree.fromstring(ENTITY.sub(lambda named: unescape(named[0]), formula))
    for found in tree.iter(f"{{{MATHML}}}munderover"):
        letter, below, accent = found
        if letter.tag == f"{{{MATHML}}}mo" or accent.tag != f"{{{MATHML}}}mo":
            continue
        found.tag = f"{{{MATHML}}}msub"
        over = ElementTree.Element(f"{{{MATHML}}}mover", accent="true")
        over.extend([letter, accent])
        found[:] = [over, below]
    return ElementTree.tostring(tree, encoding="unicode")


def _translated(node: nodes.Element, display: bool) -> str:
    try:
        return mathml(node.astext(), display)
    except MathError as error:
        LOG.warning("%s: %s", error, node.astext(), location=node)
        return f"<code>{node.astext()}</code>"


def visit_math(self, node):
    self.body.append(_translated(node, False))
    raise nodes.SkipNode


def visit_block(self, node):
    self.body.append(self.starttag(node, "div", CLASS="math"))
    if node["number"]:
        number = f"<span class='eqno'>({node['number']})"
        self.body.append(number)
        self.add_permalink_ref(node, "Link to this equation")
        self.body.append("</span>")
    self.body.append(_translated(node, True) + "</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict:
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_block, None))
    app.config.html_math_renderer_name = "mathml"
    return {"parallel_read_safe": True, "parallel_write_safe": True}
