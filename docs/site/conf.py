"""Settings of the site; `docs/site/build.py` runs Sphinx with them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.builders.html import StandaloneHTMLBuilder
from sphinx.util.logging import getLogger

sys.path.insert(0, str(Path(__file__).parent))
import gelform
from docstrings import rewrite
from links import ROOT, links_of_the_site

project, author, release = "gelform", "The gelform authors", gelform.__version__
copyright = author
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.napoleon"]
myst_enable_extensions = ["colon_fence", "dollarmath", "html_image"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = f"gelform {release}"
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
napoleon_google_docstring = False
napoleon_use_rtype = False
autodoc_mock_imports = ["torch"]  # some 800 MB, and nothing of it is read here
autodoc_typehints = "none"
autodoc_member_order = "bysource"
default_role = "literal"  # names stand in single back-ticks in docstrings
html_math_renderer = "mathml"
html_static_path = ["static"]
StandaloneHTMLBuilder.supported_image_types.append("image/webp")  # Sphinx copies no WebP otherwise
CHINESE = "docs/zh/"  # pages in another language than the site's
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_favicon = "../../src/gelform/live/page/icon.svg"
templates_path = ["templates"]
html_sidebars = {
    "**": [
        "sidebar/brand.html",
        "versions.html",
        "sidebar/search.html",
        "sidebar/scroll-start.html",
        "sidebar/navigation.html",
        "sidebar/scroll-end.html",
    ]
}
LABELED = {  # in a page of the theme, for readers who listen to it, and what stands there instead
    '<p class="caption" role="heading">': '<p class="caption" role="heading" aria-level="2">',
    '<aside class="sidebar-drawer">': '<aside class="sidebar-drawer" aria-label="Site">',
    '<aside class="toc-drawer">': '<aside class="toc-drawer" aria-label="This page">',
    '<div id="search-results">': '<h1 class="only-read">Search</h1><div id="search-results">',
}


def inline_math(self: Any, node: Any) -> None:
    """A formula in a line, as MathML: browsers draw it without a script."""
    self.body.append(str(tex2mathml(node.astext())))


def block_math(self: Any, node: Any) -> None:
    """A formula of its own; parts with a wide space between them may stand below each other on a small screen."""
    parts = (tex2mathml(part, as_block=True) for part in node.astext().split(r"\qquad"))
    self.body.append(f'<div class="math">{"".join(map(str, parts))}</div>')


def read_source(_: Any, name: str, content: list[str]) -> None:
    """The repository's pages have links that mean something else on the site."""
    page = ROOT / f"{name}.md"
    if page.exists():
        content[0] = links_of_the_site(content[0], page, getLogger(__name__).warning)


def read_docstring(_app: Any, _what: str, _name: str, _thing: Any, _options: Any, lines: list[str]) -> None:
    """As Sphinx wants them."""
    rewrite(lines)


def set_language(_: Any, name: str, _template: str, context: dict[str, Any], _doctree: Any) -> None:
    """The language that a page tells browsers and readers of screens."""
    context["language"] = "zh" if name.startswith(CHINESE) else "en"


def finish(app: Any, failed: Exception | None) -> None:
    """Label what the theme leaves without a label."""
    if failed or app.builder.name != "html":
        return
    pages = {path: path.read_text(encoding="utf-8") for path in Path(app.outdir).rglob("*.html")}
    for old, new in LABELED.items():
        if not any(old in page for page in pages.values()):
            getLogger(__name__).warning(f"The theme has changed: no page has {old}")
        pages = {path: page.replace(old, new) for path, page in pages.items()}
    for path, page in pages.items():
        path.write_text(page, encoding="utf-8")


def setup(app: Any) -> None:
    """What Sphinx calls."""

    def skip(self: Any, node: Any) -> None:
        from docutils.nodes import SkipNode

        (inline_math if node.tagname == "math" else block_math)(self, node)
        raise SkipNode

    app.connect("autodoc-process-docstring", read_docstring, priority=400)  # before napoleon
    app.add_html_math_renderer("mathml", (skip, None), (skip, None))
    app.connect("source-read", read_source)
    app.connect("html-page-context", set_language)
    app.connect("build-finished", finish)
