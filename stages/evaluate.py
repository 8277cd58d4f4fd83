"""Evaluate the models on held-out jumps, or, with ``evaluate.logs``, the final ones on other jump logs.

Examples:

    python -m stages.evaluate evaluate.logs=jumps evaluate.out=predictions
    python -m stages.evaluate evaluate.own_clock_windows=own_windows evaluate.own_clock_models=own_models
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from leapgap.errors import InputError
from leapgap.jumping.learning import (
    clock_comparison,
    evaluation,
    store,
    time_grid_comparison,
    window_extraction,
    windows,
)
from leapgap.jumping.learning.evaluation import HeldOutPredictions
from leapgap.jumping.learning.time_grid_comparison import RollOut
from leapgap.jumping.learning.windows import Windows
from leapgap.jumping.reports import learning as page
from leapgap.logs import log as jump
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json, write_json, write_text
from leapgap.runtime.output_folder import whole_folder
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot

STAGE = "stages.evaluate"
METRICS = "learning.json"


@dataclass
class EvaluateSettings:
    """Section ``evaluate`` of the configuration: models, windows and output files."""

    models: str
    windows: str
    fixed_models: str | None = None
    fixed_windows: str | None = None
    own_clock_models: str | None = None
    own_clock_windows: str | None = None
    metrics: str | None = None
    timing: str | None = None
    logs: str | None = None
    out: str | None = None


def evaluate(config: DictConfig) -> dict[str, float] | None:
    """Write the metrics and predictions of held-out jumps; with ``logs``, learning.json of those logs.

    Cross-validated errors are returned for a sweep.
    """
    section = read_config(EvaluateSettings, config.evaluate, "evaluate")
    inputs = (section.models, section.windows, section.fixed_models, section.fixed_windows, section.logs)
    own_clock = (section.own_clock_models, section.own_clock_windows)
    out = output_folder(section.out, STAGE, (*inputs, *own_clock, config.robot.model))
    models = Path(section.models)
    if section.logs is not None:
        evaluate_logs(Path(section.logs), models, load_robot(config), out)
        return None
    extracted = windows.read(Path(section.windows))
    metrics = Path(section.metrics) if section.metrics else out / METRICS
    if not len(extracted):
        note_no_logs(out, section, metrics)
        return None
    if any(own_clock):
        evaluate_clocks(section, extracted, out)
        return None
    folds, sessions = (evaluation.predict_held_out(extracted, models, prefix) for prefix in ("fold", "session"))
    figures = evaluation.metrics(folds, sessions, extracted)
    roll_outs = None if folds is None else compare_time_grids(folds, section)
    if roll_outs is not None:
        figures["landing_rms"] = time_grid_comparison.landing_rms(roll_outs)
    with whole_folder(out, STAGE) as folder:
        if folds is not None:
            evaluation.write_predictions(folds, folder)
            evaluation.write_error_by_step(folds, folder / "error_by_step.csv")
            evaluation.write_calibration(folds, folder / "calibration.csv")
            write_text(folder / "report.html", report(section, figures, folder, roll_outs))
        else:
            write_json(folder / "note.json", {"note": "one jump: none could be held out"})
        if not section.metrics:
            write_json(folder / METRICS, figures)
    if section.metrics:
        write_json(metrics, figures)
    print(f"{len(extracted)} windows of {len(extracted.jumps)} jumps predicted -> {metrics}, {out}")
    errors = figures.get("cv_mse")
    return {name: float(value) for name, value in errors.items()} if isinstance(errors, dict) else None


def note_no_logs(out: Path, section: EvaluateSettings, metrics: Path) -> None:
    """Say that there are no logs; figures that are there already are kept."""
    with whole_folder(out, STAGE) as folder:
        write_json(folder / "note.json", {"note": "no logs: nothing was predicted"})
        if not section.metrics:
            write_json(folder / METRICS, {"jumps": 0})
    print(f"no logs: {metrics} kept" if section.metrics and metrics.exists() else f"no logs: {metrics} says so")
    if not metrics.exists():
        write_json(metrics, {"jumps": 0})


def evaluate_clocks(section: EvaluateSettings, claimed: Windows, out: Path) -> None:
    """Compare models of windows by the claimed clock with those of the same windows by the logs' own clock."""
    if section.own_clock_windows is None or section.own_clock_models is None:
        missing = "own_clock_models" if section.own_clock_models is None else "own_clock_windows"
        raise InputError(f"evaluate.{missing}", "null", "a folder, as the other one of the two", "set both, or neither")
    folds = [
        evaluation.predict_held_out(cut, Path(models), "fold")
        for cut, models in (
            (claimed, section.models),
            (windows.read(Path(section.own_clock_windows)), section.own_clock_models),
        )
    ]
    metrics = Path(section.metrics) if section.metrics else None
    with whole_folder(out, STAGE) as folder:
        if folds[0] is None or folds[1] is None:
            figures: dict[str, Any] = {"jumps": len(claimed.jumps), "windows": len(claimed)}
            write_json(folder / "note.json", {"note": "one jump: none could be held out"})
        else:
            found = clock_comparison.compare(folds[0], folds[1])
            figures = clock_comparison.figures(found)
            clock_comparison.write_error_by_step(found, folder / "error_by_step.csv")
        write_json(metrics or folder / METRICS, figures)
    print(f"{len(claimed)} windows of {len(claimed.jumps)} jumps predicted by both clocks -> {metrics or out}, {out}")


def compare_time_grids(folds: HeldOutPredictions, section: EvaluateSettings) -> dict[str, RollOut] | None:
    """Roll-outs from 650 ms on variable and on fixed steps; None without models of fixed steps."""
    if section.fixed_models is None or section.fixed_windows is None:
        return None
    fixed = evaluation.predict_held_out(windows.read(Path(section.fixed_windows)), Path(section.fixed_models), "fold")
    return None if fixed is None else time_grid_comparison.compare(folds, fixed)


def report(
    section: EvaluateSettings, figures: dict[str, Any], predictions: Path, roll_outs: dict[str, RollOut] | None
) -> str:
    """The report page as HTML text."""
    seconds = read_json(Path(section.timing))["fit_seconds"] if section.timing else {}
    about = read_json(Path(section.windows) / "windows.json")
    return page.html(figures, seconds, about, Path(section.models) / "curves.csv", predictions, roll_outs)


def evaluate_logs(logs: Path, models: Path, robot: Robot, out: Path) -> None:
    """Evaluate the models trained on all jumps on other logs; warn about jumps that they were trained on."""
    name = read_json(models / "splits.json")["all"]["models"][0]
    model = store.load(models / "all", name)
    extracted = window_extraction.cut(jump.read_logs(logs), model.purpose.grid, robot)
    mse = evaluation.errors_on_other_jumps(extracted, models) if len(extracted) else {}
    with whole_folder(out, STAGE) as folder:
        write_json(folder / METRICS, {"jumps": len(extracted.jumps), "windows": len(extracted), "mse": mse})
    seen = set(extracted.jumps) & set(model.trained_on)
    if seen:
        print(f"{len(seen)} of these jumps bear names of jumps the models were trained on: no test of them")
    print(f"{len(extracted.jumps)} jumps judged -> {out / METRICS}" if mse else f"no logs in {logs}")


if __name__ == "__main__":
    run_stage(evaluate)
