"""One HTML file with everything in it."""

import base64
import hashlib
import html
from collections.abc import Sequence
from importlib import resources
from string import Template

from touchnet.viewer.scene import Scene

__all__ = ["render_page"]

SCRIPTS = ("scene.js", "geometry.js", "draw.js", "page.js")  # one after the other they are the page's script


def render_page(scene: Scene) -> str:
    """The page that shows a scene, with its first steps in it.

    Its content security policy names the one script and the one style sheet it has, and lets it connect to nothing (a
    live page: to its own server only), whatever a file name or a title holds.
    """
    folder = resources.files("touchnet.viewer")
    script = "".join((folder / name).read_text(encoding="utf-8") for name in SCRIPTS)
    style = (folder / "page.css").read_text(encoding="utf-8")
    policy = "; ".join(
        [
            "default-src 'none'",
            f"script-src '{_digest(script)}'",
            f"style-src '{_digest(style)}'",
            "img-src data:",
            f"connect-src {chr(39)}{'self' if scene.live else 'none'}{chr(39)}",
            "base-uri 'none'",
            "form-action 'none'",
        ]
    )
    blocks = [scene.pack_contacts(), *(scene.pack_step(step) for step in scene.steps)]
    return Template((folder / "page.html").read_text(encoding="utf-8")).substitute(
        policy=policy, title=html.escape(scene.title), style=style, script=script, data=_inlined(blocks)
    )


def _digest(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def _inlined(blocks: Sequence[bytes]) -> str:
    # A type that is no script's: the browser keeps the text and runs nothing.
    return "\n".join(
        f'<script type="application/gzip" class="data">{base64.b64encode(block).decode()}</script>' for block in blocks
    )
