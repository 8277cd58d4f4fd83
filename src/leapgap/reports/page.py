"""Rendering of the HTML pages: self-contained, without network; equal input gives equal bytes.

Plotly and Jinja2 are imported where a page is written, so that ``import leapgap`` stays fast.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import plotly.graph_objects as go


def render_page(template: Path, figures: dict[str, go.Figure], **values: Any) -> str:
    """Render a template file with figures, by name, and the Plotly script inside."""
    import jinja2
    import plotly.offline

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(template.parent),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template.name).render(
        plotly=plotly.offline.get_plotlyjs(),
        figures={name: embed_figure(figure, name) for name, figure in figures.items()},
        **values,
    )


def embed_figure(figure: go.Figure, name: str) -> str:
    """HTML fragment of a figure; the fixed name makes its bytes repeatable."""
    figure.update_layout(
        template="plotly_white",
        font={"family": "system-ui, sans-serif", "size": 13},
        hoverlabel={"namelength": -1},
    )
    return figure.to_html(
        full_html=False, include_plotlyjs=False, div_id=f"figure-{name}", config={"displaylogo": False}
    )
