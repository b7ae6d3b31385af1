"""Formulas as MathML, which browsers draw by themselves: a manual that is read offline loads no script for them."""

from typing import Any, NoReturn

from docutils.nodes import Node, SkipNode
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx


def inline(page: Any, node: Node) -> NoReturn:
    page.body.append(tex2mathml(node.astext()))
    raise SkipNode


def displayed(page: Any, node: Node) -> NoReturn:
    page.body.append(f'<div class="math">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_html_math_renderer("mathml", (inline, None), (displayed, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
