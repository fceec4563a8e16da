import sys
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, GoogleDocstring

from lemma import __version__

sys.path.insert(0, str(Path(__file__).parent))

project = "LEMMA Bench"
author = "The LEMMA Bench maintainers"
release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "facts"]
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
nitpicky = True
# Types in signatures and docstrings: most are of other packages, or on no page.
nitpick_ignore_regex = [(r"py:.*", r".*")]

html_theme = "furo"
html_title = f"{project} {release}"


def setup(app: Sphinx) -> None:
    """Read docstrings as they are written here."""
    app.connect("autodoc-process-docstring", read_docstring)


def read_docstring(
    app: Sphinx, what: str, name: str, found: Any, options: Any, lines: list[str]
) -> None:
    """Turn sections of Google's style into fields.

    Not of attributes: what stands before a colon there is no type.
    """
    if what not in ("attribute", "property", "data"):
        context = (app, what, name, found, options)
        lines[:] = GoogleDocstring(lines, Config(), *context).lines()
