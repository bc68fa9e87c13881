"""What is counted in the book (`benchmarks.claims.book`) keeps within its limits, and its tables of
a family list every member."""

import importlib
import inspect
import re

import pytest

pytest.importorskip("myst_parser")
pytest.importorskip("sphinx")

import jaxclear as jc
from benchmarks.claims import book

BASES = {
    "contact": jc.contact.AbstractNormalLaw,
    "friction": jc.friction.AbstractFrictionLaw,
    "wear": jc.wear.AbstractWearLaw,
    "joint": jc.joint.AbstractJoint,
    "clearance": jc.clearance.AbstractClearance,
    "coupling": jc.coupling.AbstractCoupling,
    "drive": jc.drive.AbstractDrive,
    "load": jc.load.AbstractLoad,
    "integrator": jc.integrator.AbstractIntegrator,
    "response": jc.response.AbstractResponse,
    "distribution": jc.distribution.AbstractDistribution,
    "limit_state": jc.limit_state.AbstractLimitState,
    "limit": jc.limit.AbstractLimit,
    "cost": jc.cost.AbstractCost,
    "catalogue": jc.catalogue.AbstractCatalogue,
}
ROW = re.compile(r"^\| *(.*?) *\|$", re.MULTILINE)


def members(family):
    """Names that a user may put in the place of one another; laws that are products are
    functions."""
    module = importlib.import_module(f"jaxclear.{family}")
    found = set()
    for name in module.__all__:
        value = getattr(module, name)
        law = inspect.isfunction(value) and family == "contact"
        kind = inspect.isclass(value) and issubclass(value, BASES[family])
        if law or (kind and not name.startswith("Abstract")):
            found.add(name)
    return found


def rows(page):
    return ROW.findall(book.pages()[page])


@pytest.mark.parametrize("family", ["contact", "friction", "integrator"])
def test_tables_of_choosing_offer_every_law_and_integrator(family):
    """Any other product of a force and a factor is a `ContactForce`, which stands below."""
    offered = set(re.findall(r"\w+", " ".join(rows("choosing"))))
    assert not members(family) - offered - {"ContactForce"}


def test_a_row_of_a_family_lists_every_member():
    """Drives, loads and wear laws were added, and the table stayed."""
    found = {}
    for page in book.pages():
        for row in rows(page):
            family = re.match(r"`jc\.(\w+)` *\|", row)
            if family and family[1] in BASES:
                found[family[1]] = members(family[1]) - set(re.findall(r"\w+", row))
    assert {"joint", "clearance", "coupling", "drive", "load"} <= set(found)
    assert not {family: lacking for family, lacking in found.items() if lacking}


def test_terms_that_pages_mark_are_in_the_glossary():
    assert not book.without_entry()


def test_every_public_name_is_on_a_page_of_the_api():
    assert not book.on_no_page()


def test_pages_of_the_api_show_what_may_be_typed():
    """Stored fields were shown, and arguments that are none of them were not."""
    assert not book.other_signatures()
    shown = {name: dict(book.typed(book.entries()[f"jaxclear.{name}"].shown)) for name in ASKED}
    for name, arguments in ASKED.items():
        assert arguments <= set(shown[name]), name
    assert "topology" not in shown["Mechanism"] and "order" not in shown["Mechanism"]


ASKED = {"Mechanism": {"bodies", "guess"}, "Problem": {"save"}, "Connection": {"at", "axis"}}


def test_what_is_said_of_an_argument_is_an_item_of_its_own():
    lines = book.reference.markdown(
        """Does it.

        `first`: a length [m]; `second`, `first` times two: `other` words. More of it. Raises
        `ValueError` where not. Source: somebody 1999, doi:10.1000/182.
        """,
        {"first", "second"},
    )
    assert [line for line in lines if line] == [
        "Does it.",
        "- `first`: a length [m].",
        "- `second`, `first` times two: `other` words. More of it.",
        "Raises `ValueError` where not.",
        "Source: somebody 1999, [doi:10.1000/182](https://doi.org/10.1000/182).",
    ]


@pytest.mark.parametrize("row", book.page_rows(), ids=lambda row: row["page"])
def test_paragraphs_and_heads_of_pages_are_short(row):
    assert row["longest paragraph [words]"] <= book.LIMITS["longest paragraph [words]"]
    assert row["head [words]"] <= book.LIMITS["longest head of a page [words]"]


def test_paragraphs_are_what_a_reader_sees():
    source = """# Title

The **rule** of `code here` and $x + y$.
Its second line, {term}`seats <seat>`.

- **Stressed words.** An item
  of two lines

```{code-cell} python
many words that are none
```

| a b | c |
| --- | --- |
| d e f | g |

:::{admonition} More
:class: tip
Folded **words** are read too.
:::
"""
    found = list(book.paragraphs(source))
    assert [book.words(p.text) for p in found] == [11, 7, 2, 1, 3, 1, 5]
    assert [p.terms for p in found if p.terms] == [["rule", "seat"], ["words"]]
    assert [p.is_head for p in found] == [True, True] + 5 * [False]


def test_a_warning_is_named_by_its_class_or_by_its_words():
    said = "It warns: the indentation of B reaches a tenth of it, a print shows."
    text = "Contact of B: the indentation of B reaches a tenth of its clearance."
    assert book.named("UserWarning", text, said)
    assert not book.named("UserWarning", text, "It warns of the indentation.")
    assert book.named("UnusualMagnitude", "mass", "That is an `UnusualMagnitude`.")
