"""The index of all results of the pipeline: figures, the commands that make them again, sentences, links to pages.

It reads files of metrics and reports and computes nothing. What is not there is said, with the command that makes it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

from leapgap.errors import InputError
from leapgap.reports.page import render_page
from leapgap.runtime.atomic_io import read_json

Metrics = Mapping[str, Any]
BAR_PX, ROW_PX, LABEL_PX, VALUE_PX = 320, 22, 260, 70
MOST_BARS = 14
MOST_MODELS = 7
"""Fewer of the learned models, whose errors span five orders of magnitude."""


@dataclass(frozen=True)
class Figure:
    """One figure with its unit, in words."""

    name: str
    value: str


@dataclass(frozen=True)
class Source:
    """One part of the index: which file of metrics it shows, what makes it, and where its page lies."""

    title: str
    says: str
    """What was done, in a sentence or two."""
    metrics: tuple[str, ...]
    """Files below ``metrics``; the first that exists is shown."""
    command: str
    """Makes the figures again."""
    figures: Callable[[Metrics], Sequence[Figure]]
    bars: Callable[[Metrics], Mapping[str, float]] | None = None
    unit: str = ""
    """Unit in which the bars are drawn; empty where they have none."""
    pages: Mapping[str, str] = field(default_factory=dict)
    """Files below ``data`` by what they are; those that do not exist are left out."""
    report: str | None = None
    """Folder of a diagnosis below ``data``, whose sentence is shown."""

    @property
    def published(self) -> bool:
        """Whether it is of published jumps, which have a pipeline of their own."""
        return self.metrics[0].startswith("published/")


@dataclass(frozen=True)
class Section:
    """A part of the index as it is shown."""

    source: Source
    figures: tuple[Figure, ...]
    bars: Mapping[str, float]
    sentence: str | None
    pages: Mapping[str, str]
    absent: bool
    """Whether there are no figures."""

    @property
    def chart(self) -> str:
        """The bars as SVG; empty without any."""
        return bar_chart(self.bars, self.source.unit) if self.bars else ""


def percent(value: Any) -> str:
    """A share as ``97 %``; a dash where there is none."""
    return "–" if value is None else f"{100 * value:.0f} %"


def number(value: Any) -> str:
    """A number with three significant digits; a dash where there is none."""
    return "–" if value is None else f"{value:.3g}"


def of_references(metrics: Metrics) -> list[Figure]:
    """Number of planned jumps and their largest constraint violation."""
    violation = Figure("largest constraint violation", number(metrics["max_violation"]))
    return [Figure("planned jumps", str(len(metrics["cost"]))), violation]


def of_learning(metrics: Metrics) -> list[Figure]:
    """Number of jumps, and the best models' errors."""
    ranked = sorted(metrics["cv_mse"].items(), key=lambda item: item[1])
    error = [Figure(f"mean squared error of {name}, 4-fold over jumps", number(value)) for name, value in ranked[:3]]
    return [Figure("jumps", str(metrics["jumps"])), *error]


def best_learning(metrics: Metrics) -> dict[str, float]:
    """Errors of the models, best first."""
    return dict(sorted(metrics["cv_mse"].items(), key=lambda item: item[1])[:MOST_MODELS])


def of_landing(metrics: Metrics) -> list[Figure]:
    """Mean landing error of the nearest methods, with its interval."""
    found = []
    for name, value in list(best_landing(metrics).items())[:4]:
        ends = metrics["mean_abs_error_ci95_cm"][name]
        interval = f" ({ends[0]:.2f} to {ends[1]:.2f})" if ends else ""
        found.append(Figure(f"mean size of the landing error, {name}", f"{value:.2f} cm{interval}"))
    return found


def best_landing(metrics: Metrics) -> dict[str, float]:
    """Mean landing errors by hardware and method, smallest first."""
    return dict(sorted(metrics["mean_abs_error_cm"].items(), key=lambda item: item[1])[:MOST_BARS])


def of_diagnosis(metrics: Metrics) -> list[Figure]:
    """Verdict, gap before and after, share closed on logs not fitted on."""
    return [
        Figure("verdict", f"{metrics['verdict']}: {metrics['answer'] or 'no cause'}"),
        Figure("gap closed on logs not fitted on", percent(metrics["closure_heldout"])),
        Figure(
            "gap, nominal and corrected", f"{number(metrics['gap_nominal'])} and {number(metrics['gap_corrected'])}"
        ),
        Figure("noise floor", number(metrics["noise_floor"])),
    ]


def of_injected(metrics: Metrics) -> list[Figure]:
    """Scores on effects that were injected one by one."""
    names = {
        "injected_named_first": "injected effects named first",
        "injected_coverage": "truths inside their 95 % intervals",
        "none_correct": "unchanged robots left unnamed",
        "pairs_both_named": "pairs of effects of which both are named",
    }
    return [
        Figure("cases", str(metrics["cases"])),
        *(Figure(words, percent(metrics[key])) for key, words in names.items()),
    ]


BLIND_WORDS = {
    "named_first": "of detectable single causes, named first",
    "named_in_set": "of them, in the named set",
    "wrongly_named": "of all cases, given a wrong name",
    "unknown_recall": "of effects without a name, called unknown",
    "none_correct": "of robots without a gap, left unnamed",
    "pairs_both_named": "of pairs, both named",
    "triples_members_named": "of the detectable members of triples, named",
    "coverage": "truths inside their 95 % intervals",
}


def of_blind(metrics: Metrics) -> list[Figure]:
    """Scores of the blind check."""
    shares = [Figure(words, percent(metrics[key])) for key, words in BLIND_WORDS.items() if key in metrics]
    return [Figure("sealed cases", str(metrics["cases"])), *shares]


def bars_of_blind(metrics: Metrics) -> dict[str, float]:
    """The same scores in per cent."""
    return {words: 100 * metrics[key] for key, words in BLIND_WORDS.items() if metrics.get(key) is not None}


def of_robots(metrics: Metrics) -> list[Figure]:
    """Verdict on each log of a real robot, beside the published answer."""
    found = []
    for name, case in metrics["cases"].items():
        answer = " + ".join(" or ".join(names) for names in case["answer"]) or "no cause"
        right = "right" if case["right"] else "not right"
        found.append(
            Figure(name.replace("_", " "), f"{case['verdict']}: {answer} ({right}; published: {case['published']})")
        )
    return found


def of_hostile(metrics: Metrics) -> list[Figure]:
    """Counts of hostile inputs, ticks and kills."""
    return [Figure(name.replace("_", " "), str(value)) for name, value in metrics.items() if isinstance(value, int)]


SOURCES = (
    Source(
        "References",
        "Jumps planned by full-body trajectory optimisation.",
        ("references_own.json",),
        "dvc repro optimize@own",
        of_references,
        bars=lambda metrics: metrics["cost"],
        unit="cost",
        pages={"page": "views/references.html"},
    ),
    Source(
        "Learned models, simulated jumps",
        "Residual models and their rivals predict jumps that they have not seen.",
        ("learning.json",),
        "dvc repro evaluate@simulated",
        of_learning,
        bars=best_learning,
        unit="mean squared error",
        pages={"page": "predictions/simulated/report.html"},
    ),
    Source(
        "Learned models, published jumps",
        "The same on the sixteen published jumps of the A1.",
        ("published/learning.json",),
        "dvc repro published/dvc.yaml:evaluate",
        of_learning,
        bars=best_learning,
        unit="mean squared error",
        pages={"page": "predictions/published/report.html"},
    ),
    Source(
        "Landings",
        "Where each method lands, in closed loop on simulated hardware that no controller knows.",
        ("landing.json",),
        "dvc repro land",
        of_landing,
        bars=best_landing,
        unit="cm",
        pages={"page": "pages/landings/report.html"},
    ),
    Source(
        "Landings of all methods on all robots",
        "The same with every method, time grid and run that the tables of the documentation are of.",
        ("landing_full.json",),
        "make full",
        of_landing,
        bars=best_landing,
        unit="cm",
        pages={"page": "landings_full/report.html"},
    ),
    Source(
        "Landings with the corrected robot",
        "Planning for the robot as it was diagnosed.",
        ("landing_corrected.json",),
        "dvc repro land_corrected",
        of_landing,
        bars=best_landing,
        unit="cm",
        pages={"page": "pages/landings_corrected/report.html"},
    ),
    Source(
        "Diagnosis of the published jumps",
        "What the A1's simulation lacks, by the jumps alone.",
        ("published/diagnosis.json",),
        "dvc repro published/dvc.yaml:report",
        of_diagnosis,
        pages={"report": "reports/published/report.html"},
        report="reports/published",
    ),
    Source(
        "Diagnosis of damped joints",
        "Simulated jumps with one hidden effect.",
        ("damped/diagnosis.json",),
        "dvc repro report@damped",
        of_diagnosis,
        pages={"report": "reports/damped/report.html"},
        report="reports/damped",
    ),
    Source(
        "Injected effects",
        "Every effect of the table, injected at several sizes, alone and in pairs.",
        ("diagnosis.json",),
        "python -m tests.benchmarks.diagnosis_injected --json metrics/diagnosis.json",
        of_injected,
    ),
    Source(
        "Blind check",
        "Robots whose cause was sealed before they were judged, of another simulation than the diagnosing one.",
        ("blind.json",),
        "make blind",
        of_blind,
        bars=bars_of_blind,
        unit="%",
        pages={"page of the full check": "blind/page/index.html", "page of a small one": "withheld/page/index.html"},
    ),
    Source(
        "Real robots",
        "Logs of real robots whose answers others published; the rule was written before the run.",
        ("real/robots.json",),
        "make robots",
        of_robots,
    ),
    Source(
        "Hostile inputs and kills",
        "Broken files, absurd values, impossible ticks, processes that are killed.",
        ("hostile.json",),
        "make hostile",
        of_hostile,
    ),
)
"""Parts of the index in the order in which things flow."""


def sections(root: Path, published: bool | None = None) -> list[Section]:
    """Parts of the index of the project in ``root``: of published jumps, of all else, or, where it is None, of both."""
    return [section(source, root) for source in SOURCES if published in (None, source.published)]


def section(source: Source, root: Path) -> Section:
    """One part: what its files say."""
    path = next((one for name in source.metrics if (one := root / "metrics" / name).is_file()), None)
    figures: tuple[Figure, ...] = ()
    bars: dict[str, float] = {}
    if path is not None:
        figures, bars = read_figures(source, path)
    pages = {words: name for words, name in source.pages.items() if (root / "data" / name).is_file()}
    data = root / "data" / source.report / "report.json" if source.report else None
    sentence = read_json(data).get("sentence") if data is not None and data.is_file() else None
    return Section(source, figures, bars, sentence, pages, path is None)


def read_figures(source: Source, path: Path) -> tuple[tuple[Figure, ...], dict[str, float]]:
    """Figures and bars of a file of metrics; ``InputError`` for one that has not the form that its command writes."""
    metrics = read_json(path)
    try:
        bars = source.bars(metrics) if source.bars else {}
        return tuple(source.figures(metrics)), {name: float(value) for name, value in bars.items()}
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        says = f"other figures than {source.title!r} has ({type(error).__name__}: {error})"
        raise InputError(path, says, "what its command writes", f"make it anew: {source.command}") from None


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
        lines += [f"| {one.name} | {one.value} | `{part.source.command}` |" for one in part.figures]
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
