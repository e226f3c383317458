"""Jinja templates of pages and charts."""

from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from ..safe_io.text_files import escape_invisible


def rendered(template: str, **values: object) -> Markup:
    """Fill a template of this folder; all values are escaped, and invisible characters are written out."""
    return Markup(_TEMPLATES.get_template(template).render(values))


def _visible(value: object) -> object:
    return value if isinstance(value, Markup) else escape_invisible(str(value))


_TEMPLATES = Environment(
    loader=PackageLoader(__package__ or "", ""),
    autoescape=True,
    finalize=_visible,
    trim_blocks=True,
    lstrip_blocks=True,
)
