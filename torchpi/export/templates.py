"""Render the text of exported files from the templates in this folder."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jinja2

HERE = Path(__file__).parent


def rendered(template: str, context: Mapping[str, Any], **filters: Callable[..., str]) -> str:
    """Render a template, given by its path in this folder, with `context`; a missing name is an error."""
    folder, _, name = template.rpartition("/")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE / folder),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= filters
    return environment.get_template(name).render(context)
