"""The benchmark as one HTML page: self-contained, without network; it links to the reports beside it."""

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from leapgap.diagnosis.report import round_floats
from leapgap.reports.kept import KEPT, write_kept_pages
from leapgap.reports.page import CORRECTED, GREY, NOMINAL, embed_figure, heat_map, render_text
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
from leapgap.validation.scoring import CONDITIONS
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


RIGHT, WRONG = "#14804a", "#c0391b"
BARS = {
    "named_first": ("named first, of detectable single effects", 0.97, ">="),
    "named_in_set": ("within the reported set", 0.97, ">="),
    "set_size_mean": ("mean size of the reported set", 2.0, "<="),
    "right_or_honest": ("right, or nothing false stated as a fact", 0.90, ">="),
    "wrongly_named": ("a wrong `named`, of all cases", 0.03, "<="),
    "unknown_recall": ("`unknown` or `partly`, of detectable off-table effects", 0.90, ">="),
    "none_correct": ("`none`, of robots with nothing wrong", 0.95, ">="),
    "where_right": ("localisation right: phase and channel of the largest share", None, ""),
    "where_overlap": ("overlap of the map with the true one, above five noise floors", 0.80, ">="),
    "where_top_three": ("largest true share among the three largest of the map", None, ""),
    "pairs_both_named": ("both of a pair named", 0.85, ">="),
    "triples_members_named": ("named, of the detectable members of triples", 0.60, ">="),
    "parameter_error_median": ("median parameter error", 0.03, "<="),
    "coverage": ("95 % intervals that contain the truth (0.92 to 0.97)", 0.92, ">="),
    "closure_promise_error": ("mean |predicted − actual explained share|", 0.05, "<="),
    "next_experiment_resolves": ("ambiguous cases that the next experiment resolves", 0.80, ">="),
    "further_jumps_find": ("missed effects that are found with further jumps", None, ""),
    "struck_honest_mirrored": ("right answer with the true effect ablated", 0.90, ">="),
    "uneven_clock_first": ("the clock named first, of logs with uneven rows", 0.90, ">="),
    "uneven_effect_named": ("the detectable effect beside uneven rows named too", None, ""),
    "third_none_correct": ("`none`, in a third physics", 0.95, ">="),
    "third_named_first": ("named first, of detectable single effects in a third physics", None, ""),
    "too_high_named_first": ("named first, of detectable too high friction, damping or armature", None, ""),
    "brier": ("Brier score of the first cause's probability", None, ""),
    "calibration_error": ("calibration error", None, ""),
}
"""Score → its description, its bar, and the side of the bar that is good."""
COVERAGE_MOST = 0.97
NOTHING = '<p class="note">No such case.</p>'
HALVES = {
    "reported": "reported: unseen seed, other families; cases of withhold.chosen were opened before",
    "tuning": "tuning: thresholds may have seen it",
}


def page(
    outcomes: Sequence[CaseOutcome],
    halves: Mapping[str, Mapping[str, Any]],
    revisits: Mapping[str, Mapping[str, Any]],
    settings: ScoreSettings,
    out: Path,
) -> str:
    """The page as HTML text, with links to the reports relative to ``out``; equal scores give equal bytes."""
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
    figures = {
        f"{kind}_{half}": embed_figure(figure, f"{kind}-{half}") if has_points(figure) else NOTHING
        for half, these in of_half.items()
        for own in [rows_of(half, rows)]
        for kind, figure in (
            ("confusion", confusion_matrix(scoring.confusion(these))),
            ("limits", detection(scoring.detection_limits(these))),
            ("reliability", calibration(scoring.reliability(these, settings.bins))),
            ("parameters", parameters(own)),
            ("closure", closure(own)),
        )
    }
    wrong = [r for r in rows if r["half"] in halves and (r["wrongly_named"] or not r["right"])]
    # One row per bar that a half misses, with the cases that count against it, the most frequent first
    lines = []
    for line, key in zip(score_table(halves), BARS, strict=True):
        for half in HALVES:
            if line[half]["reaches"] is False and key in CONDITIONS:
                against = [r for r in rows_of(half, rows) if key in r["counted_against"]]
                names = Counter(f"{' + '.join(r['true']) or r['kind']} → {describe_answer(r, key)}" for r in against)
                cases = ", ".join(f"{name}{f' ({n}×)' if n > 1 else ''}" for name, n in names.most_common())
                reason = explain_misses(key, against, revisits["missed"])
                lines.append({"half": half, "words": line["words"], "cases": cases, "why": reason})
    return render_text(
        Path(__file__).with_name("validation.html"),
        figures,
        halves=HALVES,
        table=score_table(halves),
        names_of_robots={half: list(halves[half]["robots"]) for half in halves},
        robots={half: robot_table(halves[half]["robots"]) for half in halves},
        missed=lines,
        counts={half: (halves[half]["cases"], halves[half]["detectable"]) for half in halves},
        wrong=sorted(wrong, key=lambda r: (not r["wrongly_named"], r["half"], r["case"])),
        rows=rows,
        published=[r for r in rows if r["half"] == "published"],
        ablated=revisits["struck"],
        experiments=revisits["experiments"],
        further=revisits["missed"],
    )


def score_table(halves: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """One row per score: description, bar, and for each half the value and whether it reaches the bar."""
    lines = []
    for key, (words, bar, side) in BARS.items():
        line: dict[str, Any] = {"words": words, "bar": "" if bar is None else f"{'≥' if side == '>=' else '≤'} {bar:g}"}
        for half in HALVES:
            value = halves[half].get(key)
            interval = None
            if isinstance(value, Mapping):
                value, interval = value["value"], value["ci95"]
            reaches = None
            if value is not None and bar is not None:
                reaches = (value >= bar if side == ">=" else value <= bar) and not (
                    key == "coverage" and value > COVERAGE_MOST
                )
            text = "–" if value is None else f"{value:.3g}"
            if value is not None and interval and interval[0] is not None:
                text += f" ({interval[0]:.3g} to {interval[1]:.3g})"
            line[half] = {"text": text, "reaches": reaches}
        lines.append(line)
    return lines


def robot_table(scores: Mapping[str, Mapping[str, Any]]) -> dict[str, list[str]]:
    """Words for a score → its value for each class of cases, in their order; empty where there is but one class."""
    if len(scores) < 2:
        return {}
    lines = {"cases": [str(own["cases"]) for own in scores.values()]}
    lines["detectable"] = [str(own["detectable"]) for own in scores.values()]
    for key, (words, *_) in BARS.items():
        values = [own.get(key) for own in scores.values()]
        if any(value is not None for value in values):
            lines[words] = ["–" if value is None else f"{value:.3g}" for value in values]
    return lines


def rows_of(half: str, rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The rows of one half that are of the pipeline's own robot."""
    return [row for row in rows if row["half"] == half and row["robot"] is None]


def explain_misses(key: str, against: Sequence[Mapping[str, Any]], missed: Mapping[str, Mapping[str, Any]]) -> str:
    """Sentences on the cases that count against a score: the kind of miss, and the result with further jumps."""
    if key == "where_right":
        sides = sum(r["where_mirrored"] for r in against)
        return f"{sides} of {len(against)} are right but for the side: in symmetric jumps, noise decides between sides."
    silent = sum(r["verdict"] in ("none", "unknown") for r in against)
    words = [f"{silent} of {len(against)} change four jumps too little to be named." if silent else ""]
    again = [missed[r["case"]] for r in against if r["case"] in missed]
    if again:
        found = sum(e["found"] for e in again)
        words.append(f"With further jumps ({' '.join(again[0]['collect'])}) {found} of {len(again)} are found.")
    return " ".join(word for word in words if word)


def describe_answer(row: Mapping[str, Any], key: str) -> str:
    """The answer to one case in words; for ``where_right`` the reported and the true location."""
    if key != "where_right":
        return str(row["said"])
    places = (" ".join(place) if place else "nowhere" for place in (row["where_said"], row["where_true"]))
    return " instead of ".join(places)


def has_points(figure: go.Figure) -> bool:
    """Whether a figure shows any case."""
    return any(len(trace.y or ()) and getattr(trace, "mode", None) != "lines" for trace in figure.data)


def confusion_matrix(table: Mapping[str, Mapping[str, int]]) -> go.Figure:
    """Matrix of counts: true effects (rows) against the first cause or the verdict (columns)."""
    said = sorted({name for row in table.values() for name in row}, key=lambda n: (n in ("none", "unknown"), n))
    truths = list(table)
    counts = [[table[t].get(s, 0) for s in said] for t in truths]
    texts = [[str(n) if n else "" for n in row] for row in counts]
    figure = heat_map(counts, said, truths, texts, "true %{y}, said %{x}: %{z}", colorscale="Blues", showscale=False)
    figure.update_layout(height=140 + 24 * len(truths), margin={"l": 250, "r": 20, "t": 120, "b": 10})
    figure.update_xaxes(side="top", tickangle=-45)
    return figure


def detection(limits: Mapping[str, Mapping[str, Any]]) -> go.Figure:
    """Every case of one effect by how much the effect changes the motion: found or missed, and the detection limit."""
    figure = go.Figure()
    for found, name, colour in ((True, "found", RIGHT), (False, "missed", WRONG)):
        points = [(c["change_floors"], e) for e, of in limits.items() for c in of["cases"] if c["found"] == found]
        figure.add_scatter(
            x=[max(x, 0.05) for x, _ in points],
            y=[e for _, e in points],
            mode="markers",
            name=name,
            marker={"color": colour, "size": 9, "opacity": 0.75},
        )
    known = [(of["limit_floors"], e) for e, of in limits.items() if of["limit_floors"] is not None]
    figure.add_scatter(
        x=[x for x, _ in known],
        y=[e for _, e in known],
        mode="markers",
        name="detection limit",
        marker={"symbol": "line-ns-open", "size": 20, "color": "#111827", "line": {"width": 2}},
    )
    figure.add_vline(x=2, line={"color": GREY, "dash": "dot", "width": 1})
    figure.update_xaxes(type="log", title_text="change of the motion by the effect, noise floors (dotted: detectable)")
    figure.update_yaxes(categoryorder="category descending")
    figure.update_layout(height=130 + 24 * len(limits), margin={"l": 170, "r": 20, "t": 30, "b": 45})
    return figure


def calibration(bins: Sequence[tuple[float, float, int]]) -> go.Figure:
    """Reliability diagram: share of right first causes over the probability they are given."""
    figure = go.Figure()
    figure.add_scatter(x=[0, 1], y=[0, 1], mode="lines", line={"color": GREY, "dash": "dot"}, showlegend=False)
    figure.add_scatter(
        x=[p for p, _, _ in bins],
        y=[r for _, r, _ in bins],
        mode="lines+markers+text",
        text=[str(n) for _, _, n in bins],
        textposition="top center",
        marker={"color": CORRECTED, "size": 10},
        showlegend=False,
    )
    figure.update_xaxes(range=[0, 1.05], title_text="probability given")
    figure.update_yaxes(range=[0, 1.1], title_text="share right")
    figure.update_layout(height=360, margin={"l": 60, "r": 20, "t": 20, "b": 45})
    return figure


def parameters(rows: Sequence[Mapping[str, Any]]) -> go.Figure:
    """Estimated over true departure from nominal, with the reported intervals."""
    points = [(r, c) for r in rows for c in r["compared"] if c["true"] != c["nominal"]]
    ratio, low, high, names = [], [], [], []
    for r, c in points:
        true = c["true"] - c["nominal"]
        ends = sorted(((c["low"] - c["nominal"]) / true, (c["high"] - c["nominal"]) / true))
        at = (c["value"] - c["nominal"]) / true
        ratio.append(at)
        low.append(max(0.0, at - ends[0]))
        high.append(max(0.0, ends[1] - at))
        names.append(f"{c['effect']} {c['parameter']} ({r['case']})")
    figure = go.Figure(
        go.Scatter(
            x=ratio,
            y=names,
            mode="markers",
            marker={"color": CORRECTED, "size": 8},
            error_x={"type": "data", "symmetric": False, "array": high, "arrayminus": low, "color": GREY},
        )
    )
    figure.add_vline(x=1, line={"color": RIGHT, "dash": "dot"})
    title = "estimated / true departure from nominal (95 % interval as reported)"
    figure.update_xaxes(title_text=title, range=[-0.5, 3])
    figure.update_layout(height=100 + 20 * len(names), margin={"l": 280, "r": 20, "t": 10, "b": 45})
    return figure


def closure(rows: Sequence[Mapping[str, Any]]) -> go.Figure:
    """Promised against realised closure, %; within the dotted lines they differ by at most 5 points."""
    points = [r for r in rows if r["promised"] is not None and r["realised"] is not None]
    figure = go.Figure()
    for shift in (-5, 5):
        line = {"color": GREY, "dash": "dot", "width": 1}
        figure.add_scatter(x=[0, 100], y=[shift, 100 + shift], mode="lines", line=line, showlegend=False)
    figure.add_scatter(
        x=[100 * r["promised"] for r in points],
        y=[100 * r["realised"] for r in points],
        text=[f"{r['case']}: {r['said_true']}" for r in points],
        mode="markers",
        marker={"color": [CORRECTED if r["detectable"] else NOMINAL for r in points], "size": 9},
        showlegend=False,
        hovertemplate="%{text}<br>predicted %{x:.0f} %, actual %{y:.0f} %<extra></extra>",
    )
    figure.update_xaxes(range=[-5, 108], title_text="predicted on held-out jumps, %")
    figure.update_yaxes(range=[-60, 108], title_text="actual, on jumps kept with the truth, %")
    figure.update_layout(height=380, margin={"l": 60, "r": 20, "t": 20, "b": 45})
    return figure
