"""Pages from Jinja2 templates with escaped values."""

import base64
import io
import json
import re
from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape
from PIL import Image

_INLINE = (
    (re.compile(r"\[([^]]*)\]\(([^)]*)\)"), r"\1"),
    (re.compile(r"`([^`]+)`"), r"<code>\1</code>"),
    (re.compile(r"\*\*([^*]+)\*\*"), r"<b>\1</b>"),
    (re.compile(r"\*([^*]+)\*"), r"<em>\1</em>"),
)


def inline(text: str) -> Markup:
    """Return a line of Markdown as HTML; links become plain text."""
    html = str(escape(text))
    for mark, element in _INLINE:
        html = mark.sub(element, html)
    return Markup(html)


def jpeg(picture: Image.Image) -> bytes:
    """Return a picture as the content of a JPEG file."""
    buffer = io.BytesIO()
    picture.save(buffer, "JPEG", quality=86, optimize=True)
    return buffer.getvalue()


def data_uri(kind: str, content: bytes) -> str:
    """Return a file's content as a data URI, so that a page needs no other file."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def script_text(text: str) -> Markup:
    """Return text as a JavaScript string without sequences that end a script."""
    literal = json.dumps(text, ensure_ascii=False)
    return Markup(literal.replace("</", "<\\/").replace("<!", "\\u003c!"))


_PAGES = Environment(
    loader=PackageLoader("lemma.viz", "pages"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
# Keep the order of keys.
_PAGES.policies["json.dumps_kwargs"] = {"sort_keys": False, "ensure_ascii": False}
_PAGES.filters["inline"] = inline
_PAGES.filters["data_uri"] = lambda content, kind: data_uri(kind, content)
_PAGES.globals["file"] = lambda name: Markup(
    (files(__package__) / name).read_text("utf-8")
)


def fill(template: str, **values: object) -> str:
    """Return a page.

    Args:
        template: Name of the template, a file in this folder.
        values: Values of its variables; text is escaped.
    """
    return _PAGES.get_template(template).render(values)


def macro(template: str, name: str, *values: object) -> str:
    """Return a part of a page, from a macro of a template; text is escaped."""
    return str(getattr(_PAGES.get_template(template).module, name)(*values)).strip()
