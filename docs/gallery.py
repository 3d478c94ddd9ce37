"""The scenes that are made in code, with the previews that ``fovden scenes -o docs/pictures`` writes."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from fovden.tracer.procedural import SCENES

PICTURES = Path(__file__).parent / "pictures"


class Gallery(SphinxDirective):
    """A section for each scene: what its function says of it, and its previews."""

    def run(self) -> list[nodes.Node]:
        """Returns the sections, in the order of the scenes' table."""
        self.env.note_reread()  # pictures come and go without a trace in the page
        return [self.section(name) for name in SCENES]

    def section(self, name: str) -> nodes.section:
        """Returns the section of a scene."""
        description = (inspect.getdoc(SCENES[name]) or "").split("\n\nArgs:")[0]
        summary, _, rest = description.removeprefix("Returns ").partition("\n\n")
        section = nodes.section("", nodes.title("", name), ids=[nodes.make_id(name)], names=[name])
        for text in [summary[:1].upper() + summary[1:], *filter(None, rest.split("\n\n"))]:
            markdown = re.sub(r":(\w+):`", r"{\1}`", " ".join(text.split()))  # roles as in these pages
            section += nodes.paragraph("", "", *self.parse_inline(markdown)[0])
        for picture in [*PICTURES.glob(f"{name}.png"), *sorted(PICTURES.glob(f"{name}_*.png"))]:
            view = picture.stem.removeprefix(name).replace("_", " ").strip()
            section += nodes.figure(
                "",
                nodes.image(uri=f"pictures/{picture.name}", alt=f"{name}, {view or 'its own camera'}"),
                nodes.caption("", view or "its own camera"),
            )
        return section


def setup(app: Sphinx) -> dict[str, bool]:
    """Registers the directive."""
    app.add_directive("gallery", Gallery)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
