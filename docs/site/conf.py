"""Settings of the site; `docs/site/build.py` runs Sphinx with them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from docutils.utils.math.latex2mathml import tex2mathml

sys.path.insert(0, str(Path(__file__).parent))
import gelform
from docstrings import rewrite
from links import linked_to_the_reference

project, author, release = "gelform", "The gelform authors", gelform.__version__
copyright = author
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = f"gelform {release}"
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
napoleon_google_docstring = False
napoleon_use_rtype = False
autodoc_typehints = "none"
autodoc_member_order = "bysource"
default_role = "literal"  # names stand in single back-ticks in docstrings
html_math_renderer = "mathml"
html_static_path: list[str] = []


def inline_math(self: Any, node: Any) -> None:
    """A formula in a line, as MathML: browsers draw it without a script."""
    self.body.append(str(tex2mathml(node.astext())))


def block_math(self: Any, node: Any) -> None:
    """A formula of its own."""
    self.body.append(
        f'<div class="math" style="overflow-x: auto">{tex2mathml(node.astext(), as_block=True)}</div>'
    )


def read_source(_: Any, name: str, content: list[str]) -> None:
    """Links to a function's source file become links to its reference."""
    content[0] = linked_to_the_reference(content[0])


def setup(app: Any) -> None:
    """What Sphinx calls."""

    def skip(self: Any, node: Any) -> None:
        from docutils.nodes import SkipNode

        (inline_math if node.tagname == "math" else block_math)(self, node)
        raise SkipNode

    def read_docstring(
        _app: Any, _what: str, _name: str, _thing: Any, _options: Any, lines: list[str]
    ) -> None:
        rewrite(lines)

    app.connect("autodoc-process-docstring", read_docstring, priority=400)  # before napoleon
    app.add_html_math_renderer("mathml", (skip, None), (skip, None))
    app.connect("source-read", read_source)
