"""What steps of variable length buy: predictions of the landing from 650 ms on, at equal K (paper, roll-outs).

From there ten variable steps (6 × 25 ms, 4 × 100 ms) end at the landing, ten fixed ones of 25 ms at 900 ms. A fixed
model can then only hope that nothing acts any more (ballistic to the landing), or take 22 steps (more work).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from leapgap.jumping.learning.evaluation import HeldOutPredictions
from leapgap.jumping.learning.windows import RolloutInputs, Windows
from leapgap.jumping.models.rigid_body import GRAVITY, POSITION, STATE, VELOCITY

START_S = 0.65
COMPARED = ("networks", "kernel", "nominal_fitted")  # Names of the models compared, in the order of the figures


@dataclass(frozen=True)
class RollOut:
    """Predictions of H jumps from ``START_S`` on."""

    time_s: np.ndarray  # Times since the start of the jump, (n,)
    states: np.ndarray  # x from the start of the roll-out, (H, n, 6)


def compare(variable: HeldOutPredictions, fixed: HeldOutPredictions) -> dict[str, RollOut]:
    """Measured, and each model's, by name: ``measured``, ``<model>/variable``, ``…/fixed``, ``…/fixed_k22``.

    The predictions are those of the models that did not see the jump.
    """
    found = {"measured": measured_roll_out(fixed.windows)}
    for model in COMPARED:
        for name, held_out in (("variable", variable), ("fixed", fixed)):
            if model in held_out.states:
                found[f"{model}/{name}"] = predict_k_steps(held_out, model)
        if model in fixed.states:
            longer = predict_to_landing(fixed, model)
            found[f"{model}/fixed_k{len(longer.time_s) - 1}"] = longer
    return found


def first_steps(windows: Windows) -> np.ndarray:
    """The window of each jump that starts at ``START_S``, (H,); none where no window does."""
    return np.flatnonzero(np.isclose(windows.time_s[:, 0], START_S))


def measured_roll_out(windows: Windows) -> RollOut:
    """The measured motion of the jumps, on the fine steps."""
    at = first_steps(windows)
    whole = [jump_inputs(windows, int(windows.jump[i]), int(windows.start[i])) for i in at]
    return RollOut(whole[0][1], np.stack([states for _, _, states in whole]))


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


def predict_to_landing(held_out: HeldOutPredictions, model: str) -> RollOut:
    """Predictions of as many steps as it takes to the landing."""
    windows, states = held_out.windows, []
    for i in first_steps(windows):
        inputs, times, _ = jump_inputs(windows, int(windows.jump[i]), int(windows.start[i]))
        states.append(held_out.models[windows.jumps[windows.jump[i]]][model].predict(inputs)[0])
    return RollOut(times, np.stack(states))


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
    inputs = RolloutInputs(
        state=states[:1],
        force=windows.force[w, s][None],
        foot=windows.foot[w, s][None],
        contact=windows.contact[w, s][None],
        time_s=times[None, :-1],
        step_s=windows.step_s[w, s][None],
        start=np.array([start]),
    )
    return inputs, times, states


def landing_rms(found: Mapping[str, RollOut]) -> dict[str, dict[str, float]]:
    """Root mean square error at the landing over the jumps, by component and roll-out; m, rad, m/s, rad/s."""
    truth = found["measured"].states[:, -1]
    rms = {
        name: np.sqrt(((roll_out.states[:, -1] - truth) ** 2).mean(axis=0))
        for name, roll_out in found.items()
        if name != "measured"
    }
    return {component: {name: float(f"{r[i]:.6g}") for name, r in rms.items()} for i, component in enumerate(STATE)}
