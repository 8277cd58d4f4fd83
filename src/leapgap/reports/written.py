"""What commands and notebooks say of reports and effects, as lines, tables and HTML for a person."""

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from importlib.util import find_spec
from pathlib import Path

from leapgap import effects
from leapgap.diagnosis.report import Cause, ReportContent
from leapgap.effects.base import Effect
from leapgap.export import exports
from leapgap.reports.diagnosis import BEST, CORRECTED, PAGE, RECORDING, REPORT
from leapgap.robot.mjcf import ASSETS
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json
from leapgap.simulation.corrected import CORRECTED_HOLDS, MODEL, NOMINAL, PARAMETERS, README, placed_in_words

HOLDS = {
    PAGE: "the report to read in a browser",
    REPORT: "the same as data",
    RECORDING: "one log and its replays, for the Rerun viewer",
    BEST: "the model with every number fitted: for prediction, not for explanation",
    CORRECTED: "the model with the identified causes:",
}
"""What each file and folder of a report holds."""
VIEWER = "the viewer's package rerun-sdk is not installed (pip install 'leapgap[view]')"


def what_was_written(folder: Path) -> list[str]:
    """What a report's folder holds, file by file, what it lacks and why, and of each identified effect where it is."""
    own = {**CORRECTED_HOLDS, ASSETS: "the meshes and pictures of these models"}
    inside = own | {name: kind.says.replace("`", "") for name, kind in exports().items()}
    lines = [f"written to {folder}:", *named(folder, HOLDS, "  "), *named(folder / CORRECTED, inside, "    ")]
    if not (folder / RECORDING).exists():
        lines.append(f"  no {RECORDING}: {VIEWER if find_spec('rerun') is None else 'none was asked for'}")
    if (folder / CORRECTED / README).is_file():
        lacking = [name for name in inside if name != ASSETS and not (folder / CORRECTED / name).exists()]
        lines += [f"  no {CORRECTED}/{name}: {CORRECTED}/{README} says why" for name in lacking]
    return [*lines, *effects_of(folder)]


def named(folder: Path, holds: Mapping[str, str], indent: str) -> list[str]:
    """The files of a folder that are there, with what each holds."""
    there = [name for name in holds if (folder / name).exists()]
    width = max((len(name) for name in there), default=0)
    return [f"{indent}{name:<{width}}  {holds[name]}" for name in there]


def effects_of(folder: Path) -> Iterator[str]:
    """Of each effect in ``corrected`` where it is."""
    corrected = folder / CORRECTED
    if (corrected / PARAMETERS).is_file():
        missing = [name for name in (MODEL, NOMINAL) if not (corrected / name).is_file()]
        for line in placed_in_words(read_json(corrected / PARAMETERS), missing):
            yield f"  {line}"


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


def effect_rows(robot: Robot | None) -> list[tuple[str, ...]]:
    """Cells of the table of effects, its head first; with the nominal values and ranges of a robot, if there is one."""
    rows: list[tuple[str, ...]] = [("effect", "parameter", "unit", "nominal", "searched", "acts at", "what it is")]
    for kind in effects.known().values():
        missing = None if robot is None else kind.lacks(robot)
        places = {"none": "the robot"}.get(kind.places, kind.places)
        what = effects.describe(kind) + when_looked_for(kind)
        own = kind.parameters(robot) if robot is not None and missing is None else ()
        of_robot = {p.name: (f"{p.nominal:g}", f"{p.lower + 0.0:.3g} to {p.upper:.3g}") for p in own}
        for name, about in kind.declarations().items():
            nominal = "the model's own" if about.nominal is None else f"{about.nominal:g}"
            default = (nominal, f"needs {missing}" if missing else "see: leapgap effects ROBOT")
            called = kind.name if robot is None else kind.called(robot)
            rows.append((called, name, about.unit, *of_robot.get(name, default), places, what))
    return rows


def when_looked_for(kind: type[Effect]) -> str:
    """What stands behind an effect that is not among the usual ones; nothing behind the others."""
    if kind.by_default:
        return ""
    also = ", or with uneven time stamps" if kind.beside_clock else ""
    return f" (searched if named{also})"
