"""Windows: short stretches of jumps on the steps of the prediction, what models are trained and judged on.

A jump is sampled at the steps of a ``TimeGrid`` (25 ms in contact, 100 ms in flight); a window is K steps of that.
Here is the stored form and what it is for; ``window_extraction`` makes windows from jump logs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.learning.model_files import check_finite, read_npz, write_npz
from leapgap.jumping.models.rigid_body import Situation
from leapgap.jumping.task import ContactSchedule
from leapgap.runtime.atomic_io import read_json, write_json

FORMAT_VERSION = 1
MOST_STEPS = 10_000  # Largest number of steps of a window


@dataclass(frozen=True)
class TimeGrid:
    """Steps of the horizon: short while feet push, long in flight; ``steps`` of them (K) make a window."""

    contact_step_s: float = 0.025
    flight_step_s: float = 0.1
    steps: int = 10

    def __post_init__(self) -> None:
        steps_are_lengths = 0 < self.contact_step_s < np.inf and 0 < self.flight_step_s < np.inf  # false for NaN
        if not steps_are_lengths or not 1 <= self.steps <= MOST_STEPS:
            raise InputError("time grid", str(self), "steps longer than nothing, one or more", "correct conf/chunk")

    def contact_steps(self, schedule: ContactSchedule) -> int:
        """Steps of a whole jump that begin before take-off."""
        return whole_steps("time until take-off", schedule.take_off_s, self.contact_step_s)

    def jump_steps(self, schedule: ContactSchedule) -> int:
        """Steps of a whole jump (N): in contact, then in flight."""
        return self.contact_steps(schedule) + whole_steps("flight", schedule.flight_s, self.flight_step_s)

    def sample_times(self, schedule: ContactSchedule) -> np.ndarray:
        """When each step of a whole jump begins, and when the last one ends, s, shape (N + 1,)."""
        contact, steps = self.contact_steps(schedule), np.arange(self.jump_steps(schedule) + 1)
        flight = schedule.take_off_s + (steps - contact) * self.flight_step_s
        return np.where(steps < contact, steps * self.contact_step_s, flight)


def whole_steps(phase: str, length_s: float, step_s: float) -> int:
    """Number of steps in a phase; ``InputError`` where they do not fill it."""
    steps = length_s / step_s
    if abs(steps - round(steps)) > 1e-6:
        shorter, longer = np.floor(steps) * step_s, np.ceil(steps) * step_s
        found = f"{length_s:g} s, which is not a whole number of {step_s:g} s steps"
        do = "choose a step that divides the phase, or another schedule"
        raise InputError(f"time grid, {phase}", found, f"for instance {shorter:g} s or {longer:g} s", do)
    return round(steps)


@dataclass(frozen=True)
class RolloutInputs:
    """What a model may know of W windows of K steps: the first state, and what acts during the steps."""

    state: np.ndarray  # First state: x z pitch and rates, m, rad, s; x from the window's start, z in the world; (W, 6)
    force: np.ndarray  # Ground forces on the robot, front x z, rear x z, N, world axes; zero in flight; (W, K, 4)
    foot: np.ndarray  # Foot − base, mean of the pair, front x z, rear x z, m, world axes; (W, K, 4)
    contact: np.ndarray  # Whether each step begins before take-off, bool, (W, K)
    time_s: np.ndarray  # Scheduled start of each step, since the start of the jump, (W, K): the phase
    step_s: np.ndarray  # Length of each step, (W, K)
    start: np.ndarray  # Number of each window's first step in its jump, int, (W,)

    def __len__(self) -> int:
        return len(self.state)

    @property
    def without_measured_future(self) -> "RolloutInputs":
        """For forecasts: forces and feet measured after the first step, which leak the future state, are withheld."""
        known = np.arange(self.force.shape[1]) == 0
        return replace(
            self, force=np.where(known[:, None], self.force, np.nan), foot=np.where(known[:, None], self.foot, np.nan)
        )


@dataclass(frozen=True)
class Windows:
    """W windows of K steps, cut from the named jumps on one grid and schedule with one robot's kinematics."""

    grid: TimeGrid
    schedule: ContactSchedule | None  # Contact schedule of all jumps; None where there are no windows
    robot: str
    robot_sha256: str
    jumps: tuple[str, ...]
    jump: np.ndarray  # Which of ``jumps`` each window is of, int, (W,)
    start: np.ndarray  # Number of each window's first step in its jump, int, (W,)
    start_x: np.ndarray  # World x of the base at each window's first sample, m, (W,)
    state: np.ndarray  # Measured states: x z pitch and rates; x from the window's start, z in the world; (W, K + 1, 6)
    force: np.ndarray  # As in ``RolloutInputs``, (W, K, 4)
    foot: np.ndarray  # As in ``RolloutInputs``, (W, K, 4)
    time_s: np.ndarray  # Scheduled time of each sample since the start of the jump, (W, K + 1)
    step_s: np.ndarray  # Length of each step, (W, K): as scheduled, or as long as it was by the log's own clock
    contact: np.ndarray  # Whether each step begins before take-off, bool, (W, K)

    def __len__(self) -> int:
        return len(self.jump)

    @property
    def steps_as_scheduled(self) -> bool:
        """Whether every step is as long as its schedule says, so that no log's own clock said otherwise."""
        return np.array_equal(self.step_s, np.diff(self.time_s, axis=1))

    @property
    def inputs(self) -> RolloutInputs:
        """What a model may know of them: everything but the states after the first."""
        shared = {name: getattr(self, name) for name in ("force", "foot", "contact", "step_s", "start")}
        return RolloutInputs(state=self.state[:, 0], time_s=self.time_s[:, :-1], **shared)

    def of_jumps(self, names: Sequence[str]) -> "Windows":
        """The windows of some of the jumps only, in their order here."""
        kept = tuple(name for name in self.jumps if name in set(names))
        number = {self.jumps.index(name): i for i, name in enumerate(kept)}
        mask = np.isin(self.jump, list(number))
        arrays = {name: getattr(self, name)[mask] for name in ARRAYS}
        arrays["jump"] = np.array([number[int(j)] for j in arrays["jump"]], dtype=int)
        return replace(self, jumps=kept, **arrays)

    def thin(self, most: int) -> "Windows":
        """The same windows, or ``most`` of them spread evenly."""
        kept = spread_evenly(len(self), most)
        return self if len(kept) == len(self) else replace(self, **{name: getattr(self, name)[kept] for name in ARRAYS})


def spread_evenly(count: int, most: int) -> np.ndarray:
    """Places of all of ``count`` items, or of ``most`` of them at equal distances."""
    number = min(most, count)
    return np.arange(number) * count // max(number, 1)


Motion = TypeVar("Motion", RolloutInputs, Windows)


def drop_forces(motion: Motion) -> Motion:
    """The same motion with forces and feet at zero, as a forecast sees it: what acts later is not known to it."""
    return replace(motion, force=np.zeros_like(motion.force), foot=np.zeros_like(motion.foot))


ARRAYS = tuple(field.name for field in fields(Windows) if field.type == np.ndarray)


@dataclass(frozen=True)
class Purpose:
    """What a model of windows predicts; another grid, schedule or robot needs another model."""

    grid: TimeGrid
    schedule: ContactSchedule
    robot: str
    robot_sha256: str

    @staticmethod
    def of(windows: Windows) -> "Purpose":
        """Purpose of models that are trained on these windows."""
        assert windows.schedule is not None, "there are windows"
        return Purpose(windows.grid, windows.schedule, windows.robot, windows.robot_sha256)

    @staticmethod
    def from_json(about: Mapping[str, Any]) -> "Purpose":
        """Read back what ``asdict`` made of it."""
        return Purpose(
            TimeGrid(**about["grid"]), ContactSchedule(**about["schedule"]), about["robot"], about["robot_sha256"]
        )

    def require(self, needed: "Purpose", where: object) -> None:
        """Refuse a model that was trained for something else than ``needed``."""
        for name, mine in asdict(self).items():
            wanted = asdict(needed)[name]
            if mine != wanted and name != "robot":
                do = "train models for it (stages.chunk, stages.train), or use what they were trained for"
                raise InputError(where, f"a model for {name} {mine}", f"{name} {wanted}, as is needed here", do)


def write(windows: Windows, folder: Path) -> None:
    """Write ``windows.npz`` and ``windows.json``; the same windows give the same bytes.

    Lengths of steps are stored where they are not those of the schedule.
    ``InputError`` for windows with values that are not finite.
    """
    check(windows, "the windows")
    folder.mkdir(parents=True, exist_ok=True)
    left_out = {"step_s"} if windows.steps_as_scheduled else set()
    note = "" if windows.steps_as_scheduled else "steps are as long as they were by the logs' own clock"
    if not len(windows):
        note = "no logs: nothing was cut"
    write_npz(folder / "windows.npz", {name: getattr(windows, name) for name in ARRAYS if name not in left_out})
    write_json(
        folder / "windows.json",
        {
            "format_version": FORMAT_VERSION,
            "windows": len(windows),
            "jumps": list(windows.jumps),
            "note": note,
            "grid": asdict(windows.grid),
            "schedule": asdict(windows.schedule) if windows.schedule else None,
            "robot": windows.robot,
            "robot_sha256": windows.robot_sha256,
        },
    )


def read(folder: Path) -> Windows:
    """Windows from a folder that ``write`` filled; ``InputError`` where it is of another format."""
    about = read_json(folder / "windows.json")
    if about.get("format_version") != FORMAT_VERSION:
        says = f"format_version {about.get('format_version')}"
        raise InputError(folder / "windows.json", says, str(FORMAT_VERSION), "run stages.chunk again")
    arrays = read_npz(folder / "windows.npz")
    try:
        arrays.setdefault("step_s", np.diff(arrays["time_s"], axis=-1))
        found = Windows(
            grid=TimeGrid(**about["grid"]),
            schedule=ContactSchedule(**about["schedule"]) if about["schedule"] else None,
            robot=about["robot"],
            robot_sha256=about["robot_sha256"],
            jumps=tuple(about["jumps"]),
            **arrays,
        )
        check(found, folder)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise unfit(folder, repr(error)) from None
    return found


def unfit(where: object, said: str) -> InputError:
    """The refusal of windows whose parts contradict each other."""
    return InputError(where, f"windows that do not fit ({said})", "windows of this version", "run stages.chunk again")


def check(windows: Windows, where: object) -> None:
    """Raise ``InputError`` for windows whose arrays contradict each other, or whose values are not finite."""
    count, steps = len(windows.jump), windows.grid.steps
    shapes = {name: (count, *shape) for name, shape in shapes_of(steps).items()}
    for name, shape in shapes.items():
        array, kind = getattr(windows, name), np.dtype(KINDS.get(name, float)).kind
        if array.shape != shape or array.dtype.kind != kind:
            expected = f"shape {shape} and kind {kind}, for {count} windows of {steps} steps"
            raise unfit(where, f"{name} has shape {array.shape} and kind {array.dtype.kind}, not {expected}")
    check_finite({name: getattr(windows, name) for name in ARRAYS}, where, "cut them again from whole logs")
    names = windows.jumps
    if len(set(names)) != len(names) or not all(isinstance(name, str) for name in names):
        raise unfit(where, "names of jumps that are no texts or that are there twice")
    if count and windows.schedule is None:
        raise unfit(where, "no contact schedule")
    numbers, counts = np.unique(windows.jump, return_counts=True)
    if not np.array_equal(numbers, np.arange(len(names))) or len(set(counts.tolist())) > 1:
        raise unfit(where, f"{len(names)} jumps, of which {len(numbers)} have {sorted(set(counts.tolist()))} windows")
    lengths = (np.diff(windows.time_s, axis=1), windows.step_s)
    if count and ((windows.start < 0).any() or any((length <= 0).any() for length in lengths)):
        raise unfit(where, "steps that end before they begin")


KINDS: dict[str, type] = {"jump": int, "start": int, "contact": bool}  # Of arrays that hold no fractions


def shapes_of(steps: int) -> dict[str, tuple[int, ...]]:
    """Shape of what each array holds of one window, by its name."""
    return {
        **{"jump": (), "start": (), "start_x": (), "time_s": (steps + 1,), "contact": (steps,)},
        "step_s": (steps,),
        **{"state": (steps + 1, 6), "force": (steps, 4), "foot": (steps, 4)},
    }


@dataclass(frozen=True)
class Transitions:
    """n single measured steps, each once however many windows share it."""

    situation: Situation
    force: np.ndarray  # Ground forces on the robot, as in ``RolloutInputs``, (n, 4), N
    contact: np.ndarray  # Whether each step begins before take-off, bool, (n,)
    step_s: np.ndarray  # Length of each step, (n,)
    step: np.ndarray  # Number of the step in its jump, (n,)
    jump: np.ndarray  # Number of the jump among those of the windows, (n,)
    increment: np.ndarray  # Next state minus state, (n, 6)

    @property
    def acceleration(self) -> np.ndarray:
        """(vx, vz, pitch rate) gained per second of the step, (n, 3)."""
        return self.increment[:, 3:] / self.step_s[:, None]

    def at(self, which: np.ndarray) -> "Transitions":
        """Some of them, by mask or by index."""
        arrays = {name: array[which] for name, array in vars(self).items() if name != "situation"}
        return Transitions(self.situation.at(which), **arrays)


def steps_of(windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """Every step of the jumps once, as the numbers of a window and of a step in it, int, (n,) each."""
    last = np.zeros(len(windows.jumps), dtype=int)
    np.maximum.at(last, windows.jump, windows.start)
    w, k = np.nonzero((np.arange(windows.grid.steps) == 0) | (windows.start == last[windows.jump])[:, None])
    return w, k


def extract_transitions(windows: Windows) -> Transitions:
    """The steps of some windows: the first of each window, and all of a jump's last window."""
    inputs = windows.inputs
    w, k = steps_of(windows)
    state = windows.state[w, k]
    situation = Situation(state, inputs.foot[w, k], inputs.time_s[w, k], windows.state[w, 0])
    acting = inputs.force[w, k], inputs.contact[w, k], inputs.step_s[w, k]
    return Transitions(situation, *acting, windows.start[w] + k, windows.jump[w], windows.state[w, k + 1] - state)
