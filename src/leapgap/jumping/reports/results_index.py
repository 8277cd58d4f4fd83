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
MOST_BARS = 14
MOST_RANKED = 4
"""Of a ranked figure, those that stand in words."""


class Shown:
    """A figure as a template shows it: ``{key:%}`` a share, ``{key:#}`` a count of entries, ``{key}`` three digits."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __format__(self, how: str) -> str:
        if self.value is None:
            return "–"
        if how == "#":
            return str(len(self.value))
        if how == "%":
            return f"{100 * self.value:.0f} %"
        return f"{self.value:.3g}" if isinstance(self.value, float) else str(self.value or "no cause")


@dataclass(frozen=True)
class Source:
    """One part of the index: which file of metrics it shows, what makes it, and where its page lies."""

    title: str
    says: str
    """What was done, in a sentence or two."""
    metrics: str
    """Path of the JSON file of its figures, below the folder ``metrics``."""
    command: str
    """Makes the figures again."""
    figures: Mapping[str, str] = field(default_factory=dict)
    """Words → template of their value (``Shown``)."""
    partial: bool = False
    """Whether a file may lack some of the figures."""
    cases: bool = False
    """Whether its figures are verdicts on cases of real robots, by name."""
    ranked: str | None = None
    """Key of a mapping by name that is drawn, the smallest first."""
    ranked_words: str | None = None
    """What the smallest of them are, in words, ``{}`` the name; None: they are drawn alone."""
    ranked_interval: str | None = None
    """Key of their intervals."""
    unit: str = ""
    """Of what is drawn."""
    pages: Mapping[str, str] = field(default_factory=dict)
    """Files below ``data`` by what they are; those that do not exist are left out."""
    report: str | None = None
    """Folder of a diagnosis below ``data``, whose sentence is shown."""

    @property
    def published(self) -> bool:
        """Whether it is of published jumps, which have a pipeline of their own."""
        return self.metrics.startswith("published/")


@dataclass(frozen=True)
class Section:
    """A part of the index as it is shown."""

    source: Source
    figures: Mapping[str, str]
    """Words → value."""
    bars: Mapping[str, float]
    sentence: str | None
    pages: Mapping[str, str]
    absent: bool
    """Whether there are no figures."""

    @property
    def chart(self) -> str:
        """The bars as SVG; empty without any."""
        return bar_chart(self.bars, self.source.unit) if self.bars else ""


PLANNED = {"planned jumps": "{cost:#}", "largest constraint violation": "{max_violation}"}
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
    "sealed cases": "{cases}",
    "of detectable single causes, named first": "{named_first:%}",
    "of them, in the named set": "{named_in_set:%}",
    "of all cases, given a wrong name": "{wrongly_named:%}",
    "of effects without a name, called unknown": "{unknown_recall:%}",
    "of robots without a gap, left unnamed": "{none_correct:%}",
    "of pairs, both named": "{pairs_both_named:%}",
    "of the detectable members of triples, named": "{triples_members_named:%}",
    "truths inside their 95 % intervals": "{coverage:%}",
}
HOSTILE = {
    name.replace("_", " "): f"{{{name}}}"
    for name in (
        *("inputs", "refused", "set_aside", "accepted_harmless", "accepted_nonsense", "traceback", "hang", "memory"),
        *("ticks", "nonfinite", "outside_limits", "exceptions", "kills", "partial_visible", "orphans", "bytes_differ"),
    )
}
LEARNED: dict[str, Any] = {
    "figures": {"jumps": "{jumps}"},
    "ranked": "cv_mse",
    "ranked_words": "mean squared error of {}, 4-fold over jumps",
    "unit": "mean squared error",
}
LANDED: dict[str, Any] = {
    "ranked": "mean_abs_error_cm",
    "ranked_words": "mean size of the landing error, {}",
    "ranked_interval": "mean_abs_error_ci95_cm",
    "unit": "cm",
}
SOURCES = (
    Source(
        "References", "Jumps planned by full-body trajectory optimisation.", "references_own.json",
        "dvc repro optimize@own", PLANNED, ranked="cost", unit="cost", pages={"page": "views/references.html"},
    ),
    Source(
        "Learned models, simulated jumps", "Residual models and their rivals predict jumps that they have not seen.",
        "learning.json", "dvc repro evaluate@simulated", pages={"page": "predictions/simulated/report.html"}, **LEARNED,
    ),
    Source(
        "Learned models, published jumps", "The same on the sixteen published jumps of the A1.",
        "published/learning.json", "dvc repro published/dvc.yaml:evaluate",
        pages={"page": "predictions/published/report.html"}, **LEARNED,
    ),
    Source(
        "Landings", "Where each method lands, in closed loop on simulated hardware that no controller knows.",
        "landing.json", "dvc repro land", pages={"page": "pages/landings/report.html"}, **LANDED,
    ),
    Source(
        "Landings of all methods on all robots",
        "The same with every method, time grid and run that the tables of the documentation are of.",
        "landing_full.json", "make full", pages={"page": "landings_full/report.html"}, **LANDED,
    ),
    Source(
        "Landings with the corrected robot", "Planning for the robot as it was diagnosed.", "landing_corrected.json",
        "dvc repro land_corrected", pages={"page": "pages/landings_corrected/report.html"}, **LANDED,
    ),
    Source(
        "Diagnosis of the published jumps", "What the A1's simulation lacks, by the jumps alone.",
        "published/diagnosis.json", "dvc repro published/dvc.yaml:report", DIAGNOSED,
        pages={"report": "reports/published/report.html"}, report="reports/published",
    ),
    Source(
        "Diagnosis of damped joints", "Simulated jumps with one hidden effect.", "damped/diagnosis.json",
        "dvc repro report@damped", DIAGNOSED,
        pages={"report": "reports/damped/report.html"}, report="reports/damped",
    ),
    Source(
        "Injected effects", "Every effect of the table, injected at several sizes, alone and in pairs.",
        "diagnosis.json", "python -m tests.benchmarks.diagnosis_injected --json metrics/diagnosis.json", INJECTED,
    ),
    Source(
        "Blind check",
        "Robots whose cause was sealed before they were judged, of another simulation than the diagnosing one.",
        "blind.json", "make blind", BLIND, partial=True,
        pages={"page of the full check": "blind/page/index.html", "page of a small one": "withheld/page/index.html"},
    ),
    Source(
        "Real robots", "Logs of real robots whose answers others published; the rule was written before the run.",
        "real/robots.json", "make robots", cases=True,
    ),
    Source(
        "Hostile inputs and kills", "Broken files, absurd values, impossible ticks, processes that are killed.",
        "hostile.json", "make hostile", HOSTILE, partial=True,
    ),
)  # fmt: skip
"""Parts of the index in the order in which things flow."""


def sections(root: Path, published: bool | None = None) -> list[Section]:
    """Parts of the index of the project in ``root``: of published jumps, of all else, or, where it is None, of both."""
    return [section(source, root) for source in SOURCES if published in (None, source.published)]


def section(source: Source, root: Path) -> Section:
    """One part: what its files say."""
    path = root / "metrics" / source.metrics
    figures, bars = read_figures(source, path) if path.is_file() else ({}, {})
    pages = {words: name for words, name in source.pages.items() if (root / "data" / name).is_file()}
    data = root / "data" / source.report / "report.json" if source.report else None
    sentence = read_json(data).get("sentence") if data is not None and data.is_file() else None
    return Section(source, figures, bars, sentence, pages, not path.is_file())


def read_figures(source: Source, path: Path) -> tuple[dict[str, str], dict[str, float]]:
    """Figures and bars of a file of metrics; ``InputError`` for one that has not the form that its command writes."""
    metrics = read_json(path)
    shown = {name: Shown(value) for name, value in metrics.items()}
    figures: dict[str, str] = {}
    bars: dict[str, float] = {}
    try:
        for words, template in source.figures.items():
            if not source.partial or template.strip("{}").partition(":")[0] in metrics:
                figures[words] = template.format_map(shown)
        if source.ranked:
            ranked = sorted(metrics[source.ranked].items(), key=lambda item: float(item[1]))
            bars = {name: float(value) for name, value in ranked[:MOST_BARS]}
        for name, value in list(bars.items())[:MOST_RANKED] if source.ranked_words else ():
            ends = metrics[source.ranked_interval][name] if source.ranked_interval else None
            interval = f" ({ends[0]:.3g} to {ends[1]:.3g})" if ends else ""
            unit = "" if source.unit in str(source.ranked_words) else f" {source.unit}"
            figures[str(source.ranked_words).format(name)] = f"{value:.3g}{unit}{interval}"
        for name, case in metrics["cases"].items() if source.cases else ():
            figures[name.replace("_", " ")] = of_robot(case)
        return figures, bars
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        says = f"other figures than {source.title!r} has ({type(error).__name__}: {error})"
        raise InputError(path, says, "what its command writes", f"make it again: {source.command}") from None


def of_robot(case: Mapping[str, Any]) -> str:
    """Verdict on the logs of a real robot, beside the published answer."""
    answer = " + ".join(" or ".join(names) for names in case["answer"]) or "no cause"
    right = "right" if case["right"] else "not right"
    return f"{case['verdict']}: {answer} ({right}; published: {case['published']})"


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
