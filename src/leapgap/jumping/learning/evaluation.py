"""How well models predict: cross-validated errors, and held-out predictions for people to look at."""

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from leapgap.errors import InputError
from leapgap.jumping.learning import uncertainty
from leapgap.jumping.learning.model import Model, squared_errors
from leapgap.jumping.learning.models.kernel import KernelModel
from leapgap.jumping.learning.store import find_recipe, load, recipes
from leapgap.jumping.learning.uncertainty import LEVELS, PredictionUncertainty
from leapgap.jumping.learning.windows import Purpose, Windows
from leapgap.jumping.models.rigid_body import STATE
from leapgap.runtime.atomic_io import read_json, whole_file

MEASURED = "measured"


@dataclass(frozen=True)
class HeldOutPredictions:
    """Predictions of every window by the models that did not see its jump."""

    windows: Windows
    states: Mapping[str, np.ndarray]  # Predicted states by model, (W, K + 1, 6)
    deviation: Mapping[str, np.ndarray]  # Predicted standard deviations of the errors, by model where known, (W, K, 6)
    models: Mapping[str, Mapping[str, Model]]  # Models by jump and name; none of them was trained on that jump

    def error_by_jump(self, model: str) -> np.ndarray:
        """Mean square over a jump's windows, steps and six components, of the jumps predicted, (H,)."""
        error = squared_errors(self.states[model], self.windows).mean(axis=(1, 2))
        known = np.isfinite(error)
        return np.array([error[self.windows.jump == j].mean() for j in np.unique(self.windows.jump[known])])


def predict_held_out(windows: Windows, folder: Path, prefix: str) -> HeldOutPredictions | None:
    """Predict each jump with the models of the split (of those named ``prefix``…) that held it out.

    ``None`` where there are no such splits. Models for another grid, schedule or robot are an ``InputError``.
    """
    found = read_json(folder / "splits.json")
    splits = {name: split for name, split in found.items() if name.startswith(prefix)}
    if not splits:
        return None
    states = {model: np.full_like(windows.state, np.nan) for split in splits.values() for model in split["models"]}
    deviation: dict[str, np.ndarray] = {}
    models: dict[str, dict[str, Model]] = {}
    for name, split in splits.items():
        missing = sorted(set(split["held_out"]) - set(windows.jumps))
        if missing:
            raise InputError(
                folder,
                f"models of {name} for {', '.join(missing)}",
                "models of these windows",
                "run stages.train again",
            )
        which = np.isin(windows.jump, [windows.jumps.index(jump) for jump in split["held_out"]])
        mine = windows.of_jumps(split["held_out"])
        for model in states:
            recipe = find_recipe(model, folder / "splits.json")
            stored = load(folder / name, model)
            stored.purpose.require(Purpose.of(windows), folder / name / f"{model}.json")
            if set(stored.trained_on) & set(split["held_out"]):
                raise InputError(
                    folder / name / f"{model}.json",
                    "a held-out jump among those trained on",
                    "none",
                    "run stages.train again",
                )
            inputs = mine.inputs.without_measured_future if recipe.is_forecast else mine.inputs
            states[model][which] = stored.model.predict(inputs)
            for jump in split["held_out"]:
                models.setdefault(jump, {})[model] = stored.model
            expected = read_uncertainty(folder / name, model)
            if expected is not None:
                expecting = deviation.setdefault(model, np.full_like(windows.state[:, 1:], np.nan))
                expecting[which] = expected.deviation(inputs)
    return HeldOutPredictions(windows, states, deviation, models)


def read_uncertainty(folder: Path, model: str) -> PredictionUncertainty | None:
    """The expected errors of a model, learned from the kernel that its recipe names; ``None`` where there are none."""
    source = recipes().get(recipes()[model].uncertainty_from or "")
    if source is None or not (folder / f"{source.uncertainty_file}.npz").is_file():
        return None
    kernel = load(folder, source.name).model
    assert isinstance(kernel, KernelModel)
    return uncertainty.load(folder / f"{source.uncertainty_file}.npz", kernel)


def coverage(found: HeldOutPredictions) -> dict[str, dict[str, float]]:
    """Share of held-out states inside their predicted intervals, by model and nominal level in per cent."""
    shares: dict[str, dict[str, float]] = {}
    for model in found.deviation:
        shares[model] = {
            f"{100 * level:.0f}": round_figure(is_inside_interval(found, model, level).mean()) for level in LEVELS
        }
    return shares


def is_inside_interval(found: HeldOutPredictions, model: str, level: float) -> np.ndarray:
    """Whether each held-out state lies in its predicted interval of a nominal level, bool, (W, K, 6)."""
    from scipy.special import ndtri

    error = np.abs(found.states[model][:, 1:] - found.windows.state[:, 1:])
    return error <= ndtri(0.5 + level / 2) * found.deviation[model]


def write_calibration(found: HeldOutPredictions, path: Path) -> None:
    """Coverage at many levels: model, component (and all), nominal, observed, as CSV."""
    with whole_file(path) as beside, beside.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["model", "component", "nominal", "observed"])
        for model in found.deviation:
            for level in np.arange(5, 100, 5) / 100:
                held = is_inside_interval(found, model, level)
                for component, part in {"all": held, **{name: held[..., i] for i, name in enumerate(STATE)}}.items():
                    writer.writerow([model, component, f"{level:.2f}", f"{part.mean():.6g}"])


def metrics(
    folds: HeldOutPredictions | None, sessions: HeldOutPredictions | None, windows: Windows
) -> dict[str, object]:
    """The figures of metrics/…/learning.json; errors are mean squares over mixed SI units, as published."""
    found: dict[str, object] = {"jumps": len(windows.jumps), "windows": len(windows)}
    if folds is not None:
        errors = {model: folds.error_by_jump(model) for model in folds.states}
        shown = {model: error for model, error in errors.items() if not recipes()[model].is_forecast}
        found["cv_mse"] = {model: round_figure(error.mean()) for model, error in shown.items()}
        found["cv_mse_se"] = {model: round_figure(standard_error(error)) for model, error in shown.items()}
        blind = {name: error for model, error in errors.items() if (name := recipes()[model].forecast_name)}
        found["coverage"] = coverage(folds)
        found["forecast_cv_mse"] = {model: round_figure(error.mean()) for model, error in blind.items()}
        found["forecast_cv_mse_se"] = {model: round_figure(standard_error(error)) for model, error in blind.items()}
    if sessions is not None:
        found["cv_mse_sessions"] = {
            model: round_figure(sessions.error_by_jump(model).mean())
            for model in sessions.states
            if not recipes()[model].is_forecast
        }
    return found


def cv_figures(found: HeldOutPredictions) -> dict[str, float]:
    """``<model>`` and ``<model>_se``: mean squared error on held-out jumps, and its standard error over jumps."""
    figures: dict[str, float] = {}
    for model in found.states:
        error = found.error_by_jump(model)
        figures |= {model: round_figure(error.mean()), f"{model}_se": round_figure(standard_error(error))}
    return figures


def errors_on_other_jumps(windows: Windows, folder: Path, split: str = "all") -> dict[str, float]:
    """Mean square error of each model of a split on windows of other jumps, by the model's name."""
    found = {}
    for model in read_json(folder / "splits.json")[split]["models"]:
        stored = load(folder / split, model)
        stored.purpose.require(Purpose.of(windows), folder / split / f"{model}.json")
        if not find_recipe(model, folder / "splits.json").is_forecast:
            found[model] = round_figure(squared_errors(stored.model.predict(windows.inputs), windows).mean())
    return found


def standard_error(error: np.ndarray) -> float:
    """Standard error of the mean over jumps, from the errors of each (H,)."""
    return float(error.std(ddof=1) / np.sqrt(len(error)))


def round_figure(value: float) -> float:
    """The value to six significant digits."""
    return float(f"{value:.6g}")


def write_predictions(found: HeldOutPredictions, folder: Path) -> None:
    """One Parquet file a jump, in long form, world values: model, window, step, time, and the six components."""
    windows = found.windows
    samples = windows.state.shape[1]
    for number, jump in enumerate(windows.jumps):
        mine = windows.jump == number
        blocks = {MEASURED: windows.state, **found.states}
        count = int(mine.sum())
        columns: dict[str, np.ndarray | list[str]] = {
            "model": np.repeat(list(blocks), count * samples).tolist(),
            "window": np.tile(np.repeat(windows.start[mine], samples), len(blocks)),
            "step": np.tile(np.arange(samples), count * len(blocks)),
            "time": np.tile(windows.time_s[mine].ravel(), len(blocks)),
        }
        for i, name in enumerate(STATE):
            offset = windows.start_x[mine, None] if name == "x" else 0.0
            columns[name] = np.concatenate([(states[mine][..., i] + offset).ravel() for states in blocks.values()])
        with whole_file(folder / f"{jump}.parquet") as beside:
            pq.write_table(pa.table(columns), beside, compression="zstd")


def write_error_by_step(found: HeldOutPredictions, path: Path) -> None:
    """Root mean square error over all windows: model, component, step, rms, as CSV."""
    with whole_file(path) as beside, beside.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["model", "component", "step", "rms"])
        for model, states in found.states.items():
            rms = np.sqrt(squared_errors(states, found.windows).mean(axis=0))
            for i, name in enumerate(STATE):
                writer.writerows([model, name, k + 1, f"{value:.6g}"] for k, value in enumerate(rms[:, i]))
