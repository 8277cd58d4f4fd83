"""What does the clock of the rows do to learned models: the same jumps cut by the claimed clock, and by their own?

Both cuts begin their steps at the same rows, so window for window they cover the same true time. The truth is one for
both: the states at the instants of the rows. What differs is what a model is given: 25 ms or the true length of a step,
and states as the rows show them, up to some milliseconds old, or those of the instants. Run as
``python -m tests.benchmarks.clock_comparison --json metrics/published/learning_clocks.json``: half a minute.
"""

import argparse
import csv
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.learning import windows as window_files
from leapgap.jumping.learning.evaluation import (
    HeldOutPredictions,
    coverage,
    predict_held_out,
    round_figure,
    standard_error,
)
from leapgap.jumping.learning.model import Model, squared_errors
from leapgap.jumping.learning.window_extraction import cut, cut_at, rows_at, total_forces
from leapgap.jumping.learning.windows import RolloutInputs, TimeGrid, Windows, extract_transitions, steps_of
from leapgap.jumping.models.rigid_body import POSITION, STATE, VELOCITY
from leapgap.jumping.task import schedule_of
from leapgap.logs.log import Log
from leapgap.logs.reading import read_folder
from leapgap.logs.row_clock import RowClock, with_clock
from leapgap.logs.row_clock_estimate import UNEVEN, row_clock
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import whole_file, write_json
from tests.benchmarks import run_benchmark

CLAIMED, OWN = "claimed", "own"
"""Trained and run by the claimed clock, and by the logs' own one."""
CROSSED, EXPECTED = "claimed_run_by_own", "own_expected_steps"
"""Trained by the claimed clock and run by the own one; trained by the own clock and run with expected step lengths."""
RESIDUALS_OF = ("nominal", "nominal_fitted")
"""Models whose errors in one step are the residual dynamics that others learn."""
Models = Mapping[str, Mapping[str, Model]]
"""Models by jump and name."""


@dataclass(frozen=True)
class ClockComparison:
    """Predictions of the same held-out jumps by either clock, by kind; all but ``shown`` against the same truth."""

    windows: Mapping[str, HeldOutPredictions]
    """All K steps of a window, from its measured first state."""
    steps: Mapping[str, HeldOutPredictions]
    """Every step of the jumps once, from its measured first state."""
    shown: tuple[HeldOutPredictions, HeldOutPredictions]
    """The claimed clock's predictions against its own windows: of K steps, and of one."""

    @property
    def models(self) -> list[str]:
        """Models that both clocks have."""
        return list(self.windows[OWN].states)


def compare(claimed: HeldOutPredictions, own: HeldOutPredictions) -> ClockComparison:
    """Predict the windows by both clocks; ``InputError`` where they are not windows of the same rows."""
    check_same_rows(claimed.windows, own.windows)
    names = [name for name in own.states if name in claimed.states]
    steps = {clock: single_steps(found.windows) for clock, found in ((CLAIMED, claimed), (OWN, own))}
    one_step = HeldOutPredictions(steps[CLAIMED], predict(claimed.models, names, steps[CLAIMED]), {}, {})
    return ClockComparison(
        kinds(only(claimed, names), only(own, names)),
        {
            CLAIMED: as_seen_by(one_step, steps[OWN]),
            OWN: HeldOutPredictions(steps[OWN], predict(own.models, names, steps[OWN]), {}, {}),
        },
        (only(claimed, names), one_step),
    )


def check_same_rows(claimed: Windows, own: Windows) -> None:
    """Refuse windows whose steps do not begin at the same rows of the same jumps."""
    same = (claimed.jumps, claimed.grid, claimed.schedule) == (own.jumps, own.grid, own.schedule)
    if not same or not all(np.array_equal(getattr(claimed, name), getattr(own, name)) for name in ("jump", "start")):
        raise InputError(
            "windows by the own clock",
            f"{len(own)} windows of {len(own.jumps)} jumps, {own.grid}",
            f"the {len(claimed)} windows of {len(claimed.jumps)} jumps, {claimed.grid}, of evaluate.windows",
            "cut the same logs twice",
        )


def only(found: HeldOutPredictions, names: Sequence[str]) -> HeldOutPredictions:
    """The predictions of some models."""
    chosen = {name: found.states[name] for name in names}
    return replace(found, states=chosen, deviation={n: found.deviation[n] for n in names if n in found.deviation})


def kinds(claimed: HeldOutPredictions, own: HeldOutPredictions) -> dict[str, HeldOutPredictions]:
    """All kinds of predictions of the K-step windows, against the states at the instants of the rows."""
    truth, names = own.windows, list(own.states)
    expected = replace(truth, step_s=lengths_of_others(truth))
    return {
        CLAIMED: as_seen_by(claimed, truth),
        CROSSED: HeldOutPredictions(truth, predict(claimed.models, names, truth), {}, {}),
        EXPECTED: HeldOutPredictions(truth, predict(own.models, names, expected), {}, {}),
        OWN: own,
    }


def as_seen_by(found: HeldOutPredictions, truth: Windows) -> HeldOutPredictions:
    """Predictions of the same windows cut otherwise, with x from the start that ``truth`` counts from."""
    offset = (found.windows.start_x - truth.start_x)[:, None]
    moved = {name: states.copy() for name, states in found.states.items()}
    for states in moved.values():
        states[..., 0] += offset
    return replace(found, windows=truth, states=moved)


def lengths_of_others(windows: Windows) -> np.ndarray:
    """Mean length of each step in the other jumps, s, (W, K): what is expected before a jump."""
    steps = extract_transitions(windows)
    by_step = np.zeros((len(windows.jumps), int(steps.step.max()) + 1))
    by_step[steps.jump, steps.step] = steps.step_s
    others = (by_step.sum(axis=0) - by_step) / max(1, len(by_step) - 1)
    return np.asarray(others[windows.jump[:, None], windows.start[:, None] + np.arange(windows.grid.steps)])


def single_steps(windows: Windows) -> Windows:
    """Every step of the jumps as a window of its own, each once."""
    w, k = steps_of(windows)
    state = np.stack([windows.state[w, k], windows.state[w, k + 1]], axis=1)
    start_x = state[:, 0, 0].copy()
    state[..., 0] -= start_x[:, None]
    return replace(
        windows,
        grid=replace(windows.grid, steps=1),
        jump=windows.jump[w],
        start=windows.start[w] + k,
        start_x=windows.start_x[w] + start_x,
        state=state,
        force=windows.force[w, k][:, None],
        foot=windows.foot[w, k][:, None],
        time_s=np.stack([windows.time_s[w, k], windows.time_s[w, k + 1]], axis=1),
        step_s=windows.step_s[w, k][:, None],
        contact=windows.contact[w, k][:, None],
    )


def predict(models: Models, names: Sequence[str], windows: Windows) -> dict[str, np.ndarray]:
    """States of all windows by the models that did not see their jump, by the model's name, (W, K + 1, 6)."""
    found = {name: np.empty_like(windows.state) for name in names}
    for number, jump in enumerate(windows.jumps):
        mine = windows.jump == number
        inputs: RolloutInputs = windows.of_jumps([jump]).inputs
        for name in names:
            found[name][mine] = models[jump][name].predict(inputs)
    return found


def figures(found: ClockComparison) -> dict[str, Any]:
    """The figures of metrics/…/learning_clocks.json; errors in SI units, mean squares over mixed ones as published."""
    truth, names = found.windows[OWN].windows, found.models
    return {
        "jumps": len(truth.jumps),
        "windows": len(truth),
        "step_ms": step_figures(found),
        "ten_step_mse_in_claimed_windows": mse(found.shown[0], names),
        "ten_step_mse": {kind: mse(one, names) for kind, one in found.windows.items()},
        "ten_step_mse_se": {kind: mse_se(one, names) for kind, one in found.windows.items()},
        "jumps_closer_than_claimed": {kind: jumps_closer(found, kind) for kind in found.windows if kind != CLAIMED},
        "ten_step_rms": {kind: rms(one, names) for kind, one in found.windows.items()},
        "one_step_rms": {
            kind: {phase: rms(one, names, which) for phase, which in phases(one.windows).items()}
            for kind, one in found.steps.items()
        },
        "residual_that_was_clock": residual_shares(found),
        "gained_with_time": {name: list(pair) for name, pair in gained_with_time(truth).items()},
        "coverage": {kind: coverage(found.windows[kind]) for kind in (CLAIMED, OWN)},
        "deviation_rms": {kind: deviations(found.windows[kind]) for kind in (CLAIMED, OWN)},
    }


def step_figures(found: ClockComparison) -> dict[str, dict[str, float]]:
    """Lengths of steps, ms: as claimed, and as they were."""
    claimed, own = found.shown[1].windows, found.steps[OWN].windows
    figures = {}
    for phase, pushing in (("contact", True), ("flight", False)):
        which = own.contact[:, 0] == pushing
        lengths = 1000 * own.step_s[which, 0]
        parts = {"claimed": 1000 * claimed.step_s[which, 0].mean(), "mean": lengths.mean()}
        parts |= {"shortest": lengths.min(), "longest": lengths.max()}
        figures[phase] = {name: round_figure(value) for name, value in parts.items()}
    return figures


def mse(found: HeldOutPredictions, names: Sequence[str]) -> dict[str, float]:
    """Mean square error of each model, mean over the jumps."""
    return {name: round_figure(found.error_by_jump(name).mean()) for name in names}


def mse_se(found: HeldOutPredictions, names: Sequence[str]) -> dict[str, float]:
    """Standard error over the jumps of that mean."""
    return {name: round_figure(standard_error(found.error_by_jump(name))) for name in names}


def rms(
    found: HeldOutPredictions, names: Sequence[str], which: np.ndarray | None = None
) -> dict[str, dict[str, float]]:
    """Root mean square error of each model by component, over all windows or some of them."""
    of_names = {}
    for name in names:
        squared = squared_errors(found.states[name], found.windows)
        mean = (squared if which is None else squared[which]).mean(axis=(0, 1))
        of_names[name] = by_component(np.sqrt(mean))
    return of_names


def jumps_closer(found: ClockComparison, kind: str) -> dict[str, dict[str, int]]:
    """Number of jumps that a kind predicts with a smaller mean square error than the claimed clock does.

    By model and component.
    """
    truth, counts = found.windows[OWN].windows, {}
    for name in found.models:
        errors = [squared_errors(found.windows[one].states[name], truth).mean(axis=1) for one in (kind, CLAIMED)]
        of_jumps = [np.array([e[truth.jump == j].mean(axis=0) for j in range(len(truth.jumps))]) for e in errors]
        closer = (of_jumps[0] < of_jumps[1]).sum(axis=0)
        counts[name] = {component: int(count) for component, count in zip(STATE, closer, strict=True)}
    return counts


def by_component(values: np.ndarray) -> dict[str, float]:
    """Six values by the names of the components of the state."""
    return {name: round_figure(value) for name, value in zip(STATE, values, strict=True)}


def phases(steps: Windows) -> dict[str, np.ndarray]:
    """Windows of one step in contact, and in either half of the scheduled flight, bool, (W,), where there are any.

    Feet come down before the scheduled end, so the second half is no free fall.
    """
    assert steps.schedule is not None
    contact = steps.contact[:, 0]
    early = steps.time_s[:, 0] < steps.schedule.take_off_s + steps.schedule.flight_s / 2 - 1e-6
    parts = {"contact": contact, "first_half_of_flight": ~contact & early, "second_half_of_flight": ~contact & ~early}
    return {phase: which for phase, which in parts.items() if which.any()}


def residual_shares(found: ClockComparison) -> dict[str, dict[str, dict[str, float]]]:
    """Share of the nominal body's mean squared error in one step that is gone by the own clock.

    Each clock is judged against its own windows, which is what a learner sees; below 0 where the error grew.
    """
    shares: dict[str, dict[str, dict[str, float]]] = {}
    one_step, own = found.shown[1], found.steps[OWN]
    for model in (name for name in RESIDUALS_OF if name in found.models):
        before, after = (squared_errors(one.states[model], one.windows)[:, 0] for one in (one_step, own))
        shares[model] = {
            phase: by_component(share_gone(before[which].mean(axis=0), after[which].mean(axis=0)))
            for phase, which in phases(own.windows).items()
        }
    return shares


def share_gone(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Share of what was there before that is not there after; none of nothing."""
    return 1 - np.divide(after, before, out=np.ones_like(before), where=before > 0)


def gained_with_time(windows: Windows) -> dict[str, tuple[float, float]]:
    """Whether longer steps in contact gain more: a slope and its standard error, by component.

    The same step of the jumps lasts longer in one than in another. What it gains more there, over what its rate (of
    positions the velocity at its start, of velocities the mean acceleration of all jumps) makes of the longer time: 1
    where motion goes on with time, 0 where it goes on with the rows, as commands do.
    """
    steps = extract_transitions(windows)
    more, expected = [], []
    for step in np.unique(steps.step[steps.contact]):
        mine = steps.at(steps.step == step)
        longer = (mine.step_s - mine.step_s.mean())[:, None]
        rate = np.tile(mine.increment.sum(axis=0) / mine.step_s.sum(), (len(longer), 1))
        rate[:, POSITION] = mine.situation.state[:, VELOCITY]
        more.append(mine.increment - mine.increment.mean(axis=0))
        expected.append(rate * longer)
    gained, asked = np.concatenate(more), np.concatenate(expected)
    power = (asked**2).sum(axis=0)
    slope = np.divide((gained * asked).sum(axis=0), power, out=np.zeros(len(STATE)), where=power > 0)
    spread = np.sqrt(np.divide(((gained - slope * asked) ** 2).mean(axis=0), power, out=0 * power, where=power > 0))
    pairs = zip(STATE, slope, spread, strict=True)
    return {name: (round_figure(mean), round_figure(error)) for name, mean, error in pairs}


def deviations(found: HeldOutPredictions) -> dict[str, dict[str, float]]:
    """Root mean square of the predicted standard deviations, by model and component."""
    return {
        name: by_component(np.sqrt((deviation**2).mean(axis=(0, 1)))) for name, deviation in found.deviation.items()
    }


def write_error_by_step(found: ClockComparison, path: Path) -> None:
    """Root mean square error over all windows: model with its clock, component, step, rms, as CSV."""
    with whole_file(path) as beside, beside.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["model", "component", "step", "rms"])
        for model in found.models:
            for kind in (CLAIMED, OWN):
                one = found.windows[kind]
                errors = np.sqrt(squared_errors(one.states[model], one.windows).mean(axis=0))
                for i, name in enumerate(STATE):
                    label = f"{model}, {kind} clock"
                    writer.writerows([label, name, k + 1, f"{value:.6g}"] for k, value in enumerate(errors[:, i]))


def uneven_clocks(logs: Sequence[Log], joints: Sequence[str]) -> dict[str, RowClock]:
    """Clocks, by the log's name, of the logs whose rows are uneven in a way that their time does not say."""
    clocks = ((log, row_clock(log, joints)) for log in logs)
    return {log.name: clock for log, clock in clocks if clock is not None and clock.unevenness(log) > UNEVEN}


def cut_by_own_clock(jumps: Sequence[Log], grid: TimeGrid, robot: Robot) -> Windows:
    """Windows as ``window_extraction.cut`` makes them, of logs with uneven rows by the clock of their joints."""
    clocks, claimed, pieces = uneven_clocks(jumps, robot.joints), cut(jumps, grid, robot), []
    for jump in jumps:
        if jump.name not in clocks:
            pieces.append(vars(claimed.of_jumps([jump.name])))
            continue
        rows = rows_at(jump, grid.sample_times(schedule_of(jump)))
        pieces.append(cut_at(*by_own_clock(jump, clocks[jump.name], rows), grid, robot, total_forces))
    changed = ("start_x", "state", "force", "foot", "step_s")
    return replace(claimed, **{name: np.concatenate([piece[name] for piece in pieces]) for name in changed})


def by_own_clock(jump: Log, clock: RowClock, rows: np.ndarray) -> tuple[Log, np.ndarray, np.ndarray]:
    """A log by its own clock, some of its rows there, and the time from each of them to the next, s.

    ``InputError`` where a step has no length: nothing can be learned from it.
    """
    own, kept = with_clock(jump, clock)
    there = (np.cumsum(kept) - kept)[rows]  # rows of one instant are one, at the place of the last of them
    lengths = np.diff(own.time[there])
    if (lengths <= 0).any():
        step = int(np.flatnonzero(lengths <= 0)[0])
        where = f"{jump.name}, rows {rows[step]} to {rows[step + 1]}"
        do = "leave this log out, make the steps longer, or cut it by the clock that it claims"
        raise InputError(where, "no time that passed, by the log's own clock", "steps of the grid that last", do)
    return own, there, lengths


def models_by(clock: str, logs: Path, out: Path, models: str) -> HeldOutPredictions:
    """Held-out predictions of models that are trained on the logs' windows by one clock."""
    windows, trained, robot = out / f"windows_{clock}", out / f"models_{clock}", Robot.load()
    jumps = read_folder(logs, robot).logs
    window_files.write((cut if clock == CLAIMED else cut_by_own_clock)(jumps, TimeGrid(), robot), windows)
    train = [f"train.windows={windows}", f"train.out={trained}", "train.sessions=null", f"train.models=[{models}]"]
    subprocess.run([sys.executable, "-m", "stages.train", *train], check=True)
    found = predict_held_out(window_files.read(windows), trained, "fold")
    if found is None:
        raise InputError(logs, "too few jumps", "two or more, so that one can be held out", "name another folder")
    return found


def main() -> None:
    """Train by both clocks, and write the comparison as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--logs", type=Path, help="folder of jump logs; the published ones")
    parser.add_argument("--out", type=Path, default=Path("data/clocks"), help="folder of windows, models and tables")
    parser.add_argument("--tiny", action="store_true", help="simulated jumps and one model, to see that it runs")
    chosen = parser.parse_args()
    logs = chosen.logs or Path("data/jumps/simulated" if chosen.tiny else "data/jumps/published")
    models = "nominal_fitted" if chosen.tiny else "nominal,nominal_fitted,constant_velocity,networks,kernel"
    found = compare(*(models_by(clock, logs, chosen.out, models) for clock in (CLAIMED, OWN)))
    write_error_by_step(found, chosen.out / "error_by_step.csv")
    write_json(chosen.json, figures(found))


if __name__ == "__main__":
    run_benchmark(main)
