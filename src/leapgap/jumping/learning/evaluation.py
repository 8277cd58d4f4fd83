"""How well models predict: cross-validated errors, and held-out predictions for people to look at."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from leapgap.errors import InputError
from leapgap.jumping.learning import uncertainty
from leapgap.jumping.learning.model import Model, squared_errors
from leapgap.jumping.learning.model_files import write_csv
from leapgap.jumping.learning.models.kernel import KernelModel
from leapgap.jumping.learning.store import find_recipe, load, recipes
from leapgap.jumping.learning.uncertainty import LEVELS
from leapgap.jumping.learning.windows import Purpose, RolloutInputs, Windows
from leapgap.jumping.models.rigid_body import GRAVITY, POSITION, STATE, VELOCITY
from leapgap.runtime.atomic_io import read_json, whole_file

MEASURED, AGAIN = "measured", "run stages.train again"


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
            raise InputError(folder, f"models of {name} for {', '.join(missing)}", "models of these windows", AGAIN)
        which = np.isin(windows.jump, [windows.jumps.index(jump) for jump in split["held_out"]])
        mine = windows.of_jumps(split["held_out"])
        for model in states:
            recipe = find_recipe(model, folder / "splits.json")
            stored = load(folder / name, model)
            stored.purpose.require(Purpose.of(windows), folder / name / f"{model}.json")
            if set(stored.trained_on) & set(split["held_out"]):
                where, found_there = folder / name / f"{model}.json", "a held-out jump among those trained on"
                raise InputError(where, found_there, "none", AGAIN)
            inputs = mine.inputs.without_measured_future if recipe.is_forecast else mine.inputs
            states[model][which] = stored.model.predict(inputs)
            for jump in split["held_out"]:
                models.setdefault(jump, {})[model] = stored.model
            source = recipes().get(recipe.uncertainty_from or "")
            path = None if source is None else folder / name / f"{source.uncertainty_file}.npz"
            if source is not None and path is not None and path.is_file():
                kernel = load(folder / name, source.name).model
                assert isinstance(kernel, KernelModel)
                expecting = deviation.setdefault(model, np.full_like(windows.state[:, 1:], np.nan))
                expecting[which] = uncertainty.load(path, kernel).deviation(inputs)
    return HeldOutPredictions(windows, states, deviation, models)


def coverage(found: HeldOutPredictions) -> dict[str, dict[str, float]]:
    """Share of held-out states inside their predicted intervals, by model and nominal level in per cent."""
    return {
        model: {f"{100 * p:.0f}": round_figure(is_inside_interval(found, model, p).mean()) for p in LEVELS}
        for model in found.deviation
    }


def is_inside_interval(found: HeldOutPredictions, model: str, level: float) -> np.ndarray:
    """Whether each held-out state lies in its predicted interval of a nominal level, bool, (W, K, 6)."""
    from scipy.special import ndtri

    error = np.abs(found.states[model][:, 1:] - found.windows.state[:, 1:])
    return error <= ndtri(0.5 + level / 2) * found.deviation[model]


def metrics(
    folds: HeldOutPredictions | None, sessions: HeldOutPredictions | None, windows: Windows
) -> dict[str, object]:
    """The figures of metrics/…/learning.json; errors are mean squares over mixed SI units, as published."""
    found: dict[str, object] = {"jumps": len(windows.jumps), "windows": len(windows)}
    if folds is not None:
        errors = {model: folds.error_by_jump(model) for model in folds.states}
        shown = {model: error for model, error in errors.items() if not recipes()[model].is_forecast}
        blind = {name: error for model, error in errors.items() if (name := recipes()[model].forecast_name)}
        for prefix, of in (("", shown), ("forecast_", blind)):
            found[f"{prefix}cv_mse"] = {model: round_figure(error.mean()) for model, error in of.items()}
            found[f"{prefix}cv_mse_se"] = {model: round_figure(standard_error(error)) for model, error in of.items()}
            if not prefix:
                found["coverage"] = coverage(folds)
    if sessions is not None:
        shown = {name: sessions.error_by_jump(name) for name in sessions.states if not recipes()[name].is_forecast}
        found["cv_mse_sessions"] = {model: round_figure(error.mean()) for model, error in shown.items()}
    return found


def cv_figures(found: HeldOutPredictions) -> dict[str, float]:
    """``<model>`` and ``<model>_se``: mean squared error on held-out jumps, and its standard error over jumps."""
    figures: dict[str, float] = {}
    for model in found.states:
        error = found.error_by_jump(model)
        figures |= {model: round_figure(error.mean()), f"{model}_se": round_figure(standard_error(error))}
    return figures


def standard_error(error: np.ndarray) -> float:
    """Standard error of the mean over jumps, from the errors of each (H,)."""
    return float(error.std(ddof=1) / np.sqrt(len(error)))


def round_figure(value: float) -> float:
    """The value to six significant digits."""
    return float(f"{value:.6g}")


def write_tables(found: HeldOutPredictions, folder: Path) -> None:
    """``error_by_step.csv``: root mean square over all windows; ``calibration.csv``: coverage at many levels."""
    by_step = {m: np.sqrt(squared_errors(states, found.windows).mean(axis=0)) for m, states in found.states.items()}
    rows = [
        (model, component, k + 1, f"{value:.6g}")
        for model, rms in by_step.items()
        for component, of in zip(STATE, rms.T, strict=True)
        for k, value in enumerate(of)
    ]
    write_csv(folder / "error_by_step.csv", ["model", "component", "step", "rms"], rows)
    held = [
        (model, level, is_inside_interval(found, model, level))
        for model in found.deviation
        for level in np.arange(5, 100, 5) / 100
    ]
    shares = [
        (model, component, f"{level:.2f}", f"{part.mean():.6g}")
        for model, level, inside in held
        for component, part in zip(("all", *STATE), (inside, *np.moveaxis(inside, -1, 0)), strict=True)
    ]
    write_csv(folder / "calibration.csv", ["model", "component", "nominal", "observed"], shares)


def errors_on_other_jumps(windows: Windows, folder: Path, split: str = "all") -> dict[str, float]:
    """Mean square error of each model of a split on windows of other jumps, by the model's name."""
    found = {}
    for model in read_json(folder / "splits.json")[split]["models"]:
        stored = load(folder / split, model)
        stored.purpose.require(Purpose.of(windows), folder / split / f"{model}.json")
        if not find_recipe(model, folder / "splits.json").is_forecast:
            found[model] = round_figure(squared_errors(stored.model.predict(windows.inputs), windows).mean())
    return found


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


START_S = 0.65
COMPARED = ("networks", "kernel", "nominal_fitted")  # Names of the models compared, in the order of the figures


@dataclass(frozen=True)
class RollOut:
    """Predictions of H jumps from ``START_S`` on."""

    time_s: np.ndarray  # Times since the start of the jump, (n,)
    states: np.ndarray  # x from the start of the roll-out, (H, n, 6)


def compare(variable: HeldOutPredictions, fixed: HeldOutPredictions) -> dict[str, RollOut]:
    """What steps of variable length buy (paper, roll-outs): roll-outs by name, by models that did not see the jump.

    From ``START_S`` ten variable steps (6 × 25 ms, 4 × 100 ms) end at the landing, ten fixed ones of 25 ms at 900 ms. A
    fixed model can then only hope that nothing acts any more (``…/fixed``), or take 22 steps (``…/fixed_k22``).
    """
    windows = fixed.windows
    whole = [jump_inputs(windows, int(windows.jump[i]), int(windows.start[i])) for i in first_steps(windows)]
    times, jumps = whole[0][1], [windows.jumps[windows.jump[i]] for i in first_steps(windows)]
    found = {"measured": RollOut(times, np.stack([states for _, _, states in whole]))}
    for model in COMPARED:
        for name, held_out in (("variable", variable), ("fixed", fixed)):
            if model in held_out.states:
                found[f"{model}/{name}"] = predict_k_steps(held_out, model)
        if model in fixed.states:
            models = [fixed.models[jump][model] for jump in jumps]
            states = [one.predict(inputs)[0] for one, (inputs, _, _) in zip(models, whole, strict=True)]
            found[f"{model}/fixed_k{len(times) - 1}"] = RollOut(times, np.stack(states))
    return found


def first_steps(windows: Windows) -> np.ndarray:
    """The window of each jump that starts at ``START_S``, (H,); none where no window does."""
    return np.flatnonzero(np.isclose(windows.time_s[:, 0], START_S))


def predict_k_steps(held_out: HeldOutPredictions, model: str) -> RollOut:
    """Predictions of K steps; those that end before the landing go on without forces."""
    windows = held_out.windows
    at = first_steps(windows)
    assert windows.schedule is not None
    states, times = held_out.states[model][at], windows.time_s[at[0]]
    left = windows.schedule.landing_s - times[-1]
    if left > 1e-6:
        states = np.concatenate([states, ballistic(states[:, -1], left)[:, None]], axis=1)
        times = np.append(times, windows.schedule.landing_s)
    return RollOut(times, states)


def ballistic(state: np.ndarray, time_s: float) -> np.ndarray:
    """States (n, 6) after free fall from ``state`` for ``time_s`` seconds."""
    gained = np.array([0.0, -GRAVITY * time_s, 0.0])
    after = state.copy()
    after[:, POSITION] += state[:, VELOCITY] * time_s + gained * time_s / 2
    after[:, VELOCITY] += gained
    return after


def jump_inputs(windows: Windows, jump: int, start: int) -> tuple[RolloutInputs, np.ndarray, np.ndarray]:
    """A roll-out of one jump from a step to its end, put together from its windows; times; measured states (n, 6).

    x counts from that start.
    """
    mine = np.flatnonzero(windows.jump == jump)
    last, k = mine[np.argmax(windows.start[mine])], windows.grid.steps
    total = int(windows.start[last]) + k
    by_start = {int(windows.start[i]): int(i) for i in mine}
    where = [(by_start[min(n, total - k)], n - min(n, total - k)) for n in range(start, total)]
    w, s = np.array(where).T
    absolute = windows.state[..., 0] + windows.start_x[:, None]
    states = np.concatenate([windows.state[w, s], windows.state[last, -1:]])
    states[:, 0] = np.append(absolute[w, s], absolute[last, -1]) - absolute[w[0], s[0]]
    times = np.append(windows.time_s[w, s], windows.time_s[last, -1])
    force, foot, contact, step_s = (
        array[w, s][None] for array in (windows.force, windows.foot, windows.contact, windows.step_s)
    )
    inputs = RolloutInputs(states[:1], force, foot, contact, times[None, :-1], step_s, np.array([start]))
    return inputs, times, states


def landing_rms(found: Mapping[str, RollOut]) -> dict[str, dict[str, float]]:
    """Root mean square error at the landing over the jumps, by component and roll-out; m, rad, m/s, rad/s."""
    truth = found["measured"].states[:, -1]
    rms = {
        name: np.sqrt(((roll_out.states[:, -1] - truth) ** 2).mean(axis=0))
        for name, roll_out in found.items()
        if name != "measured"
    }
    return {component: {name: round_figure(r[i]) for name, r in rms.items()} for i, component in enumerate(STATE)}
