"""Words of the glossary as targets: a page marks a term where it explains it, as {term}`rung`.

The glossary is tables with the letters of the papers, which Sphinx's own directive cannot be. What
stands in bold in their first column is what {term} finds; another word is a warning of the build.
"""

from docutils import nodes
from sphinx.application import Sphinx

PAGE = "glossary"


def collect(app: Sphinx, document: nodes.document) -> None:
    """Tells Sphinx the words of the glossary, each with a place of its own."""
    if app.env.docname != PAGE:
        return
    terms = app.env.domains.standard_domain
    for row in document.findall(nodes.row):
        for word in row.children[0].findall(nodes.strong):
            place = nodes.make_id(f"term-{word.astext()}")
            word["ids"].append(place)
            terms._note_term(word.astext(), place, location=word)


def setup(app: Sphinx) -> dict:
    app.connect("doctree-read", collect)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
