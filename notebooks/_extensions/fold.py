"""What a reader may skip, behind a line that opens it: HTML's own `<details>`, no script.

    :::{fold} How this was measured
    Text, tables, `{measured}`.
    :::

Cells run only at the top level of a page. So an empty fold takes what follows it up to the end of
its section, with cells and subsections:

    ## How this was measured

    :::{fold} The laboratory book
    :::
"""

from html import escape

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform
from sphinx.util.docutils import SphinxDirective


class Fold(nodes.Element):
    """A closed part of a page, under its title."""


class FoldDirective(SphinxDirective):
    """`{fold} TITLE`: its content, or without content the rest of its section."""

    required_arguments = 1
    final_argument_whitespace = True
    has_content = True

    def run(self) -> list[nodes.Node]:
        if any("{code-cell}" in line for line in self.content):
            raise self.error("a cell within a fold does not run: end the fold before it")
        fold = Fold(title=self.arguments[0], rest=not self.content)
        self.state.nested_parse(self.content, self.content_offset, fold)
        return [fold]


class RestOfSection(SphinxTransform):
    """Moves what follows an empty fold into it."""

    default_priority = 10

    def apply(self, **kwargs: object) -> None:
        for fold in list(self.document.findall(Fold)):
            if fold["rest"]:
                siblings = fold.parent.children
                following = siblings[siblings.index(fold) + 1 :]
                del siblings[siblings.index(fold) + 1 :]
                fold += following


def visit(self, node: Fold) -> None:
    title = escape(node["title"], quote=False)
    self.body.append(f'<details class="fold"><summary>{title}</summary>\n')


def depart(self, node: Fold) -> None:
    self.body.append("</details>\n")


def plainly(self, node: Fold) -> None:
    """Builders without folds show what is in it."""


def setup(app: Sphinx) -> dict:
    others = dict.fromkeys(("latex", "man", "texinfo", "text", "xml"), (plainly, plainly))
    app.add_node(Fold, html=(visit, depart), **others)
    app.add_directive("fold", FoldDirective)
    app.add_transform(RestOfSection)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
