"""What all HTML pages share: self-contained, no network, the same input gives the same bytes."""

from pathlib import Path
from typing import Any

import jinja2
import plotly.graph_objects as go
import plotly.offline


def rendered(template: Path, figures: dict[str, go.Figure], **values: Any) -> str:
    """A page made from a template file, with its figures and Plotly inside."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(template.parent),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template.name).render(
        plotly=plotly.offline.get_plotlyjs(),
        figures={name: embedded(figure, name) for name, figure in figures.items()},
        **values,
    )


def embedded(figure: go.Figure, name: str) -> str:
    """A figure as a fragment of the page, under a fixed name so that bytes repeat."""
    figure.update_layout(
        template="plotly_white",
        font={"family": "system-ui, sans-serif", "size": 13},
        hoverlabel={"namelength": -1},
    )
    return figure.to_html(
        full_html=False, include_plotlyjs=False, div_id=f"figure-{name}", config={"displaylogo": False}
    )
