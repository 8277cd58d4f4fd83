"""Rendering of the HTML pages: self-contained, without network; equal input gives equal bytes.

Plotly's script and long figures are packed (gzip, base64), which the browser unpacks: a page is a quarter of its size
otherwise.
"""

import base64
import gzip
import html
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import plotly.graph_objects as go
import plotly.offline

REAL, NOMINAL, CORRECTED = "#111827", "#e2542f", "#2563c9"
"""Of what was measured, of the nominal simulation and of the corrected one."""
GREY = "#8a93a3"


HEAD = "page_head.html"  # style and scripts of all pages: colours on light and dark, phones, print, figures
PACKED_FROM = 2000  # length in characters from which data of a page are packed


def render_page(template: Path, figures: dict[str, go.Figure], **values: Any) -> str:
    """Render a template file with figures, by name; ``{{ head | safe }}`` is the shared style and scripts."""
    embedded = {name: embed_figure(figure, name) for name, figure in figures.items()}
    return render_text(template, embedded, **values)


def render_text(template: Path, figures: Mapping[str, str], **values: Any) -> str:
    """Render a template file with figures that are HTML fragments already; without any, Plotly stays out."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([template.parent, Path(__file__).parent]),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    script = pack(plotly.offline.get_plotlyjs().encode()) if figures else None
    head = environment.get_template(HEAD).render(plotly=script)
    return environment.get_template(template.name).render(head=head, figures=figures, **values)


def pack(content: bytes, level: int = 9) -> str:
    """Bytes as gzip of a level in base64; equal bytes give equal text."""
    return base64.b64encode(gzip.compress(content, level, mtime=0)).decode()


def embed_json(text: str, **attributes: str) -> str:
    """A script element that holds JSON, packed where it is long; ``attributes`` name it for the page's script."""
    named = "".join(f' data-{name}="{html.escape(value)}"' for name, value in attributes.items())
    if len(text) < PACKED_FROM:
        escaped = text.replace("</", "<\\/")  # would end the element
        return f'<script type="application/json"{named}>{escaped}</script>'
    return f'<script type="text/plain" data-packed{named}>{pack(text.encode())}</script>'


def heat_map(
    values: Any, across: Sequence[str], down: Sequence[str], texts: Sequence[Sequence[str]], hover: str, **more: Any
) -> go.Figure:
    """A map with a text in each cell, its first row at the top."""
    cells = {"text": texts, "texttemplate": "%{text}", "xgap": 2, "ygap": 2}
    figure = go.Figure(go.Heatmap(z=values, x=across, y=down, hovertemplate=f"{hover}<extra></extra>", **cells, **more))
    figure.update_yaxes(autorange="reversed")
    return figure


def embed_figure(figure: go.Figure, name: str) -> str:
    """HTML fragment of a figure; the fixed name makes its bytes repeatable."""
    figure.update_layout(
        template="plotly_white", font={"family": "system-ui, sans-serif", "size": 13}, hoverlabel={"namelength": -1}
    )
    spec = json.loads(figure.to_json())
    height = spec["layout"].get("height", 450)
    text = json.dumps(spec, separators=(",", ":"), ensure_ascii=False)
    return f'<div class="figure" id="figure-{name}" style="height: {height}px"></div>\n' + embed_json(text, figure=name)
