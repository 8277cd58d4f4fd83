"""The table of the bench: one row for each case, and the figures of each family."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from leapgap.validation.outcome import LEAVES_A_REST, CaseOutcome

Row = Mapping[str, Any]
NO_ANSWER = "no answer"  # verdict of a case that took longer than its limit, or ended with an error


def row_of(o: CaseOutcome, report: Mapping[str, Any]) -> dict[str, Any]:
    """The row of a case that has a report; ``stages.bench`` adds its times."""
    evidence = report.get("evidence")
    evidence = evidence if isinstance(evidence, Mapping) else {}  # a list of checks in reports of earlier versions
    return {
        "kind": o.kind,
        "truth": o.said_true,
        "floors": o.change_floors,
        "detectable": o.detectable,
        "verdict": o.verdict,
        "answer": [list(names) for names in o.answer],
        "numbers": numbers_of(report),
        "right": o.right,
        "honest": o.honest,
        "first": o.first in o.true if o.kind == "single" and o.detectable else None,
        "whole": set(o.true) <= o.answered if o.kind == "pair" and o.each_detectable else None,
        "members": dict(o.members),
        "wrongly_named": o.wrongly_named,
        "false_names": sorted(o.false_names),
        "promised": o.promised,
        "realised": o.realised,
        **{key: evidence.get(key) for key in ("g", "u", "d")},
        "c": evidence.get("c", (report["closure_of_answer"] or {}).get("heldout")),
        "error": "",
    }


def row_without_answer(truth: Mapping[str, Any], said_true: str, error: str) -> dict[str, Any]:
    """The row of a case without a report."""
    floor = truth.get("noise_floor") or 1.0
    nothing = dict.fromkeys(("first", "whole", "promised", "realised", "g", "u", "d", "c"))
    about = {"kind": truth["kind"], "truth": said_true, "floors": (truth["change"] or 0.0) / floor}
    counted = {"right": False, "honest": False, "wrongly_named": False, "false_names": [], "members": {}}
    said: dict[str, Any] = {"verdict": NO_ANSWER, "answer": [], "numbers": [], "error": error}
    return about | {"detectable": truth["detectable"]} | nothing | counted | said


def numbers_of(report: Mapping[str, Any]) -> list[str]:
    """The causes of the answer in words: ``joint_damping at elbow: damping 0.399 (0.376 to 0.423)``."""
    in_answer = {name for names in report["answer"] for name in names}
    found: list[str] = []
    for cause in report["causes"]:
        if cause["effect"] not in in_answer or any(one.startswith(cause["effect"]) for one in found):
            continue
        values = (
            f"{name} {one['value']:.3g} ({one['ci95'][0]:.3g} to {one['ci95'][1]:.3g})"
            for name, one in cause["parameters"].items()
        )
        place = "" if cause["location"] == "all" else f" at {cause['location']}"
        found.append(f"{cause['effect']}{place}: {', '.join(values)}")
    return found


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """Counts of one family, as ``[met, asked]``, and its times."""

    def counts(key: str) -> list[int]:
        asked = [row[key] for row in rows if row.get(key) is not None]
        return [sum(asked), len(asked)]

    def among(holds: Sequence[bool]) -> list[int]:
        return [sum(holds), len(holds)]

    nameless = [row for row in rows if row["kind"] == "nameless" and row["detectable"]]
    off = [abs(r["promised"] - r["realised"]) for r in rows if r["realised"] is not None and r["detectable"]]
    times = [row["cpu_s"] for row in rows]
    return {
        "cases": len(rows),
        "right": counts("right"),
        "honest": counts("honest"),
        "first": counts("first"),
        "pairs_whole": counts("whole"),
        "members": among([found for row in rows for found in row["members"].values()]),
        "none": among([row["verdict"] == "none" for row in rows if row["kind"] == "none"]),
        "no_word_left_open": among([row["verdict"] in LEAVES_A_REST for row in nameless]),
        "no_word_without_false_name": among([row["honest"] for row in nameless]),
        "wrongly_named": counts("wrongly_named"),
        "no_answer": among([row["verdict"] == NO_ANSWER for row in rows]),
        "promise_error": float(np.mean(off)) if off else None,
        "cpu_s_median": float(np.median(times)),
        "cpu_s_most": max(times),
    }


HEAD = (
    "case",
    "truth (noise floors)",
    "verdict",
    "answer",
    "score",
    "promised → realised",
    "g, u, d, c",
    "CPU, wall s",
)


def markdown(table: Mapping[str, Mapping[str, Any]]) -> str:
    """The table as Markdown: of each family its figures, then its cases."""
    parts = []
    for family, of_family in table.items():
        figures = ", ".join(f"{key.replace('_', ' ')} {figure(value)}" for key, value in of_family["figures"].items())
        if of_family["missing"]:
            figures += f"; missing: {', '.join(of_family['missing'])}"
        rows = [line(name, row) for name, row in of_family["cases"].items()]
        parts += [f"### {family}", "", figures, "", line_of(HEAD), line_of("---" for _ in HEAD), *rows, ""]
    return "\n".join(parts)


def line(name: str, row: Row) -> str:
    """One case as a line of the table."""
    said = " + ".join(" or ".join(names) for names in row["answer"])
    score = "right" if row["right"] else "honest" if row["honest"] else "wrong"
    score += " (WRONG NAME)" if row["wrongly_named"] else ""
    answer = "; ".join(row["numbers"]) or said or row["error"]
    cells = (
        name,
        f"{row['truth']} ({row['floors']:.1f})",
        row["verdict"],
        f"{said}: {answer}" if " or " in said else answer,
        score,
        f"{figure(row['promised'])} → {figure(row['realised'])}",
        ", ".join(figure(row[key]) for key in "gudc"),
        f"{row['cpu_s']:.0f}, {row['wall_s']:.0f}",
    )
    return line_of(cells)


def figure(value: Any) -> str:
    """A figure as text: ``3 of 4`` of a count, three digits of a number, a dash of nothing."""
    if isinstance(value, list):
        return f"{value[0]} of {value[1]}"
    return "–" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)


def line_of(cells: Any) -> str:
    """A line of a Markdown table."""
    return "| " + " | ".join(str(cell).replace("|", "/") for cell in cells) + " |"
