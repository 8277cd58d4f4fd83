"""The index of all results of the pipeline: figures, the commands that make them again, sentences, links to pages.

It reads files of metrics and reports and computes nothing. What is not there is said, with the command that makes it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

from leapgap.errors import InputError
from leapgap.reports.page import render_page
from leapgap.runtime.atomic_io import read_json

BAR_PX, ROW_PX, LABEL_PX, VALUE_PX = 320, 22, 260, 70
MOST_BARS, MOST_RANKED = 14, 4  # Of a ranked figure, those that are drawn, and those that stand in words


class Shown:
    """A figure as a template shows it: ``{key:%}`` a share, ``{key:#}`` a count of entries, ``{key}`` three digits."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __format__(self, how: str) -> str:
        if self.value is None:
            return "–"
        if how:
            return str(len(self.value)) if how == "#" else f"{100 * self.value:.0f} %"
        return f"{self.value:.3g}" if isinstance(self.value, float) else str(self.value or "no cause")


@dataclass(frozen=True)
class Ranked:
    """A mapping by name that is drawn, the smallest first."""

    key: str
    unit: str
    words: str | None = None  # What the smallest of them are, ``{}`` the name; None: they are drawn alone
    interval: str | None = None  # Key of their intervals


@dataclass(frozen=True)
class Source:
    """One part of the index: which file of metrics it shows, what makes it, and where its pages lie."""

    title: str
    says: str
    metrics: str  # Path of the JSON file of its figures, below the folder ``metrics``
    command: str
    figures: Mapping[str, str] = field(default_factory=dict)
    """Words → template of their value (``Shown``); where its key begins with ``?``, a file may lack it."""
    ranked: Ranked | None = None
    pages: Mapping[str, str] = field(default_factory=dict)  # Files below ``data`` by what they are, if they exist
    report: str | None = None  # Folder of a diagnosis below ``data``, whose sentence is shown


@dataclass(frozen=True)
class Section:
    """A part of the index as it is shown: values by words, bars by name; ``absent`` where there are no figures."""

    source: Source
    figures: Mapping[str, str]
    bars: Mapping[str, float]
    sentence: str | None
    pages: Mapping[str, str]
    absent: bool

    @property
    def chart(self) -> str:
        """The bars as SVG; empty without any."""
        return bar_chart(self.bars, self.source.ranked.unit) if self.bars and self.source.ranked else ""


DIAGNOSED = {
    "verdict": "{verdict}: {answer}",
    "gap closed on logs not fitted on": "{closure_heldout:%}",
    "gap, nominal and corrected": "{gap_nominal} and {gap_corrected}",
    "noise floor": "{noise_floor}",
}
INJECTED = {
    "cases": "{cases}",
    "injected effects named first": "{injected_named_first:%}",
    "truths inside their 95 % intervals": "{injected_coverage:%}",
    "unchanged robots left unnamed": "{none_correct:%}",
    "pairs of effects of which both are named": "{pairs_both_named:%}",
}
BLIND = {
    "sealed cases": "?{cases}",
    "of detectable single causes, named first": "?{named_first:%}",
    "of them, in the named set": "?{named_in_set:%}",
    "of all cases, given a wrong name": "?{wrongly_named:%}",
    "of effects without a name, called unknown": "?{unknown_recall:%}",
    "of robots without a gap, left unnamed": "?{none_correct:%}",
    "of pairs, both named": "?{pairs_both_named:%}",
    "of the detectable members of triples, named": "?{triples_members_named:%}",
    "truths inside their 95 % intervals": "?{coverage:%}",
}
HOSTILE = {
    name.replace("_", " "): f"?{{{name}}}"
    for name in (
        *("inputs", "refused", "set_aside", "accepted_harmless", "accepted_nonsense", "traceback", "hang", "memory"),
        *("ticks", "nonfinite", "outside_limits", "exceptions", "kills", "partial_visible", "orphans", "bytes_differ"),
    )
}
PLANNED = {"planned jumps": "{cost:#}", "largest constraint violation": "{max_violation}"}
CV_MSE = Ranked("cv_mse", "mean squared error", "mean squared error of {}, 4-fold over jumps")
LANDED = Ranked("mean_abs_error_cm", "cm", "mean size of the landing error, {}", "mean_abs_error_ci95_cm")
SOURCES = (
    Source(
        "References", "Jumps planned by full-body trajectory optimisation.", "references_own.json",
        "dvc repro optimize@own", PLANNED, Ranked("cost", "cost"),
    ),
    Source(
        "Learned models, simulated jumps", "Residual models and their rivals predict jumps that they have not seen.",
        "learning.json", "dvc repro evaluate@simulated", {"jumps": "{jumps}"}, CV_MSE,
        {"page": "predictions/simulated/report.html"},
    ),
    Source(
        "Learned models, published jumps", "The same on the sixteen published jumps of the A1.",
        "published/learning.json", "dvc repro published/dvc.yaml:evaluate", {"jumps": "{jumps}"}, CV_MSE,
        {"page": "predictions/published/report.html"},
    ),
    Source(
        "Landings", "Where each method lands, in closed loop on simulated hardware that no controller knows.",
        "landing.json", "dvc repro land", {}, LANDED, {"page": "pages/landings/report.html"},
    ),
    Source(
        "Landings of all methods on all robots",
        "The same with every method, time grid and run that the tables of the documentation are of.",
        "landing_full.json", "make full", {}, LANDED, {"page": "landings_full/report.html"},
    ),
    Source(
        "Landings with the corrected robot", "Planning for the robot as it was diagnosed.", "landing_corrected.json",
        "dvc repro land_corrected", {}, LANDED, {"page": "pages/landings_corrected/report.html"},
    ),
    Source(
        "Diagnosis of the published jumps", "What the A1's simulation lacks, by the jumps alone.",
        "published/diagnosis.json", "dvc repro published/dvc.yaml:report", DIAGNOSED, None,
        {"report": "reports/published/report.html"}, "reports/published",
    ),
    Source(
        "Diagnosis of damped joints", "Simulated jumps with one hidden effect.", "damped/diagnosis.json",
        "dvc repro report@damped", DIAGNOSED, None, {"report": "reports/damped/report.html"}, "reports/damped",
    ),
    Source(
        "Injected effects", "Every effect of the table, injected at several sizes, alone and in pairs.",
        "diagnosis.json", "python -m tests.benchmarks.diagnosis_injected --json metrics/diagnosis.json", INJECTED,
    ),
    Source(
        "Blind check",
        "Robots whose cause was sealed before they were judged, of another simulation than the diagnosing one.",
        "blind.json", "make blind", BLIND, None,
        {"page of the full check": "blind/page/index.html", "page of a small one": "withheld/page/index.html"},
    ),
    Source(
        "Real robots", "Logs of real robots whose answers others published; the rule was written before the run.",
        "real/robots.json", "make robots",
    ),
    Source(
        "Hostile inputs and kills", "Broken files, absurd values, impossible ticks, processes that are killed.",
        "hostile.json", "make hostile", HOSTILE,
    ),
)  # fmt: skip
"""Parts of the index in the order in which things flow."""


def sections(root: Path, published: bool | None = None) -> list[Section]:
    """Parts of the index of the project in ``root``: of published jumps, which have a pipeline of their own, of all
    else, or, where it is None, of both."""
    found = []
    for source in [one for one in SOURCES if published in (None, one.metrics.startswith("published/"))]:
        path = root / "metrics" / source.metrics
        figures, bars = read_figures(source, path) if path.is_file() else ({}, {})
        pages = {words: name for words, name in source.pages.items() if (root / "data" / name).is_file()}
        data = root / "data" / source.report / "report.json" if source.report else None
        sentence = read_json(data).get("sentence") if data is not None and data.is_file() else None
        found.append(Section(source, figures, bars, sentence, pages, not path.is_file()))
    return found


def read_figures(source: Source, path: Path) -> tuple[dict[str, str], dict[str, float]]:
    """Figures and bars of a file of metrics; ``InputError`` for one that has not the form that its command writes."""
    metrics, ranked = read_json(path), source.ranked
    shown = {name: Shown(value) for name, value in metrics.items()}
    figures: dict[str, str] = {}
    bars: dict[str, float] = {}
    try:
        for words, template in source.figures.items():
            if not template.startswith("?") or template.strip("?{}").partition(":")[0] in metrics:
                figures[words] = template.lstrip("?").format_map(shown)
        if ranked:
            by_size = sorted(metrics[ranked.key].items(), key=lambda item: float(item[1]))
            bars = {name: float(value) for name, value in by_size[:MOST_BARS]}
            for name, value in list(bars.items())[:MOST_RANKED] if ranked.words else ():
                ends = metrics[ranked.interval][name] if ranked.interval else None
                interval = f" ({ends[0]:.3g} to {ends[1]:.3g})" if ends else ""
                unit = "" if ranked.unit in str(ranked.words) else f" {ranked.unit}"
                figures[str(ranked.words).format(name)] = f"{value:.3g}{unit}{interval}"
        for name, case in metrics["cases"].items() if source.metrics == "real/robots.json" else ():
            answer = " + ".join(" or ".join(names) for names in case["answer"]) or "no cause"
            judged = f"{'right' if case['right'] else 'not right'}; published: {case['published']}"
            figures[name.replace("_", " ")] = f"{case['verdict']}: {answer} ({judged})"
        return figures, bars
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        says = f"other figures than {source.title!r} has ({type(error).__name__}: {error})"
        raise InputError(path, says, "what its command writes", f"make it again: {source.command}") from None


def html(parts: Sequence[Section]) -> str:
    """The index as a page; its links are relative to the folder ``data``."""
    return render_page(Path(__file__).with_name("results_index.html"), {}, parts=parts)


def markdown(parts: Sequence[Section]) -> str:
    """The index as a page of the documentation, with its charts and without links into ``data``."""
    lines = [
        "# Results",
        "",
        "All figures of the project as they were last made, each with the command that makes it again.",
        "`make run` writes the same as `data/index.html`, with links to every page and recording.",
    ]
    for part in parts:
        lines += ["", f"## {part.source.title}", "", part.source.says, ""]
        if part.sentence:
            lines += [f"> {part.sentence}", ""]
        if part.absent:
            lines += [f"Not there: `{part.source.command}` makes it."]
            continue
        lines += ["| figure | value | made by |", "|---|---|---|"]
        lines += [f"| {words} | {value} | `{part.source.command}` |" for words, value in part.figures.items()]
        if part.chart:
            lines += ["", part.chart]
    return "\n".join(lines) + "\n"


def bar_chart(values: Mapping[str, float], unit: str) -> str:
    """Horizontal bars with names and values, as SVG in the colours of the page that it stands in."""
    largest = max((abs(value) for value in values.values()), default=0.0) or 1.0
    width, height = LABEL_PX + BAR_PX + VALUE_PX, ROW_PX * len(values) + 22
    rows = []
    for i, (name, value) in enumerate(values.items()):
        y, length = ROW_PX * i, BAR_PX * abs(value) / largest
        label = escape(name.replace("_", " "))
        rows.append(
            f'<text x="{LABEL_PX - 8}" y="{y + 15}" text-anchor="end">{label}</text>'
            f'<rect x="{LABEL_PX}" y="{y + 4}" width="{length:.1f}" height="{ROW_PX - 8}" rx="2"/>'
            f'<text x="{LABEL_PX + length + 6:.1f}" y="{y + 15}">{value:.4g}</text>'
        )
    axis = f'<text x="{LABEL_PX}" y="{height - 5}" opacity="0.7">{escape(unit)}</text>'
    style = "width: 100%; max-width: 720px; font: 12px system-ui, sans-serif"
    return (
        f'<svg viewBox="0 0 {width} {height}" role="img" style="{style}" fill="currentColor">'
        f"<style>rect {{ fill: var(--corrected, #2563c9); }}</style>{''.join(rows)}{axis}</svg>"
    )
