"""A report as a notebook shows it: the sentence, the gap and a table of the causes."""

from collections.abc import Sequence
from html import escape

from leapgap.diagnosis.report import Cause, ReportContent

HEADS = ("effect", "location", "parameter", "value", "95 % interval", "explains")


def summary_html(content: ReportContent, causes: Sequence[Cause], logs: int) -> str:
    """HTML without styles of its own, so that it is light or dark as the notebook is."""
    heads = "".join(f"<th>{one}</th>" for one in HEADS)
    rows = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for one in causes for row in cells(one))
    gap = f"gap {content.gap_nominal:.3g}, corrected {content.gap_corrected:.3g}, noise floor {content.noise_floor:.3g}"
    table = f"<table><tr>{heads}</tr>{rows}</table>" if causes else ""
    return f"<p><b>{escape(content.verdict)}</b>: {escape(content.sentence)}</p><p>{gap} ({logs} logs)</p>{table}"


def cells(cause: Cause) -> list[list[str]]:
    """A row for each parameter of a cause."""
    return [
        [
            escape(cause.effect),
            escape(cause.location),
            escape(name),
            f"{one.value:.3g}{'' if one.unit == '1' else f' {escape(one.unit)}'}",
            f"{one.interval[0]:.3g} to {one.interval[1]:.3g}",
            f"{100 * cause.closure.value:z.0f} %",
        ]
        for name, one in cause.parameters.items()
    ]
