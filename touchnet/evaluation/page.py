"""The report as one page: tables, curves and pictures inside the file, so that it opens anywhere without a network."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np
from PIL import Image

from touchnet import outputs
from touchnet.evaluation.curves import TITLES, Curve, colours_of, draw_curve
from touchnet.evaluation.pictures import Row
from touchnet.evaluation.tables import Table
from touchnet.figures import Picture

STYLE = """
:root { color-scheme: light; --ink: #1f2430; --soft: #616b7c; --line: #dfe3ea; --head: #f3f5f8; }
body { margin: 0 auto; padding: 2rem 1.5rem 4rem; max-width: 84rem; color: var(--ink); background: #fff;
  font: 15px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.6rem; margin: 0 0 .3rem; } h2 { font-size: 1.2rem; margin: 2.4rem 0 .8rem; }
h3 { font-size: 1rem; margin: 1.6rem 0 .5rem; } p, li { max-width: 50rem; }
nav a { margin-right: 1rem; } code { font-size: .85em; overflow-wrap: anywhere; } .soft { color: var(--soft); }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .85rem; }
th, td { padding: .25rem .6rem; text-align: right; white-space: nowrap; border-bottom: 1px solid var(--line); }
th { background: var(--head); font-weight: 600; } th:nth-child(2), td:nth-child(2) { text-align: left; }
.facts td { text-align: left; white-space: normal; }
tr.new td { border-top: 2px solid var(--soft); }
.curves { display: grid; grid-template-columns: repeat(auto-fill, minmax(22rem, 1fr)); gap: 1rem; }
figure { margin: 0; } figcaption { font-size: .8rem; color: var(--soft); } .curves img { width: 100%; }
.tiles { display: flex; gap: .5rem; overflow-x: auto; padding-bottom: .5rem; }
.tiles figure { flex: 0 0 11rem; text-align: center; } .tiles img { width: 11rem; height: 11rem; }
.none { width: 11rem; height: 11rem; display: grid; place-items: center; color: var(--soft); background: var(--head); }
"""


def write_page(
    path: Path,
    *,
    title: str,
    facts: Mapping[str, str],
    tables: Sequence[Table],
    curves: Sequence[Curve],
    rows: Sequence[Row],
    exploration: Path | None,
    definitions: Sequence[str],
) -> None:
    """Writes the page, whole or not at all.

    Args:
        facts: what was run, by name.
        tables: in their order.
        curves: drawn in groups of what was varied.
        rows: of pictures (figure 5 of the paper).
        exploration: a picture of an exploration (figure 4), if there is one.
        definitions: what the numbers mean.
    """
    parts = [f"<h1>{escape(title)}</h1>"]
    sections = {"tables": "Tables", "curves": "Curves", "gallery": "Gallery", "definitions": "Definitions"}
    parts.append("<nav>" + "".join(f'<a href="#{key}">{name}</a>' for key, name in sections.items()) + "</nav>")
    parts.append('<table class="facts">')
    parts += [f"<tr><th>{escape(name)}</th><td><code>{escape(text)}</code></td></tr>" for name, text in facts.items()]
    parts.append("</table>")
    parts.append('<h2 id="tables">Tables</h2>')
    parts += [_table(table) for table in tables]
    parts.append('<h2 id="curves">Curves</h2>')
    parts += _curves(curves)
    parts.append('<h2 id="gallery">Gallery</h2>')
    parts += _gallery(rows)
    if exploration is not None:
        parts.append("<h3>An exploration: contacts by order above, the variance that is left below</h3>")
        source = "data:image/png;base64," + base64.b64encode(exploration.read_bytes()).decode()
        said = "contacts on the object as the exploration goes on"
        parts.append(f'<div class="wide"><img src="{source}" alt="{said}"></div>')
    parts.append('<h2 id="definitions">Definitions</h2><ul>')
    parts += [f"<li>{escape(line)}</li>" for line in definitions]
    parts.append("</ul>")
    page = (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>\n'
        '<meta name="viewport" content="width=device-width">\n<link rel="icon" href="data:,">\n'
        f"<style>{STYLE}</style></head>\n<body>\n" + "\n".join(parts) + "\n</body></html>\n"
    )
    with outputs.atomic_output(path, force=True) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(text)}</th>" for text in table.header)
    lines, before = [], None
    for line in table.lines:
        # A rule where another number of contacts begins.
        kind = ' class="new"' if before not in (None, line[0]) else ""
        lines.append(f"<tr{kind}>" + "".join(f"<td>{escape(text)}</td>" for text in line) + "</tr>")
        before = line[0]
    body = "\n".join(lines)
    return (
        f'<h3>{escape(table.title)}</h3><div class="wide"><table class="figures"><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _curves(curves: Sequence[Curve]) -> list[str]:
    if not curves:
        return ['<p class="soft">Nothing was varied: see --curves.</p>']
    colours = colours_of(curves)
    parts = []
    for name in dict.fromkeys(curve.name for curve in curves):
        parts.append(f'<h3>Against {escape(name)}</h3><div class="curves">')
        for curve in curves:
            if curve.name == name:
                source = "data:image/svg+xml;base64," + base64.b64encode(draw_curve(curve, colours)).decode()
                said = f"{TITLES[curve.measure]}; {_CATEGORIES[curve.categories]}"
                parts.append(
                    f'<figure><img src="{source}" alt="{escape(said)} against {escape(name)}">'
                    f"<figcaption>{escape(said)}</figcaption></figure>"
                )
        parts.append("</div>")
    return parts


_CATEGORIES = {
    "mean": "all categories",
    "seen": "categories with training shapes",
    "unseen": "categories without a training shape",
}


def _gallery(rows: Sequence[Row]) -> list[str]:
    if not rows:
        return ['<p class="soft">No picture was asked for.</p>']
    parts = []
    for row in rows:
        parts.append(f'<h3>{escape(row.shape)}</h3><div class="tiles">')
        for title, tile in zip(row.titles, row.tiles, strict=True):
            shown = '<div class="none">no surface</div>'
            if tile is not None:
                shown = f'<img src="{_png(tile)}" alt="{escape(title)} of {escape(row.shape)}">'
            parts.append(f"<figure>{shown}<figcaption>{escape(title)}</figcaption></figure>")
        parts.append("</div>")
    return parts


def _png(picture: Picture) -> str:
    """A picture (H, W, 3) as an address that holds it, in 64 colours: a third of the bytes."""
    written = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(picture)).quantize(64).save(written, format="PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(written.getvalue()).decode()
