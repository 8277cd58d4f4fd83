"""Truths opened and verdicts scored: metrics, the scores of every case, and a page."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from leapgap.diagnosis.report import round_floats
from leapgap.reports.kept import KEPT
from leapgap.reports.pages import write_kept_pages
from leapgap.reports.validation import html
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import write_json, write_metrics, write_text
from leapgap.runtime.output_folder import whole_folder
from leapgap.validation import scoring
from leapgap.validation.half_scores import (
    REPORTED,
    TUNING,
    ScoreSettings,
    metrics,
    published_metrics,
    read_revisits,
    score_half,
    verdict_text,
)
from leapgap.validation.outcome import CaseOutcome
from leapgap.validation.seal import PUBLISHED


def write_scores(
    outcomes: Sequence[CaseOutcome], settings: ScoreSettings, robot: Robot, out: Path, by: str
) -> dict[str, float]:
    """Write the scores, a page of them and of the reports, and metrics where files are named; the metrics.

    ``robot``: the pipeline's own; ``by``: the command that writes.
    """
    revisits = read_revisits(settings.revisits)
    halves = {
        half: score_half([o for o in outcomes if o.half == half], half, revisits, settings, robot.name)
        for half in (REPORTED, TUNING)
    }
    with whole_folder(out, by) as folder:
        data = {"halves": halves, "outcomes": [asdict(o) for o in outcomes], "revisits": revisits}
        write_json(folder / "scores.json", round_floats(data))
        write_kept_pages([o.case for o in outcomes], Path(settings.verdicts), folder)
        write_text(folder / "index.html", page(outcomes, halves, revisits, settings, out))
    scores = round_floats(metrics(halves))
    if settings.metrics:
        write_metrics(Path(settings.metrics), scores)
    for o in outcomes:
        if settings.published_metrics and o.half == PUBLISHED:
            write_metrics(Path(settings.published_metrics), round_floats(published_metrics(o)))
        print(f"{o.case}: {o.said_true} ({o.change_floors:.1f} noise floors) → {verdict_text(o)}")
    print(f"page: {out / 'index.html'}")
    return {name: value for name, value in scores.items() if isinstance(value, float)}


def page(
    outcomes: Sequence[CaseOutcome],
    halves: Mapping[str, Mapping[str, Any]],
    revisits: Mapping[str, Mapping[str, Any]],
    settings: ScoreSettings,
    out: Path,
) -> str:
    """The page as HTML text, with links to the reports relative to ``out``."""
    at = os.path.relpath(settings.verdicts, out)
    rows = [
        {
            **asdict(o),
            "right": o.right,
            "wrongly_named": o.wrongly_named,
            "where_right": o.where_right,
            "where_mirrored": o.where_mirrored,
            "counted_against": scoring.counted_against(o),
            "said": verdict_text(o),
            "report": f"{'' if (Path(settings.verdicts) / o.case / KEPT).is_file() else f'{at}/'}{o.case}/report.html",
        }
        for o in outcomes
    ]
    of_half = {half: [o for o in scoring.of_pipeline(outcomes) if o.half == half] for half in halves}
    return html(
        halves=halves,
        rows=rows,
        revisits=revisits,
        confusion={half: scoring.confusion(these) for half, these in of_half.items()},
        limits={half: scoring.detection_limits(these) for half, these in of_half.items()},
        reliability={half: scoring.reliability(these, settings.bins) for half, these in of_half.items()},
    )
