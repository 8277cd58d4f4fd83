"""Windows: short stretches of jumps on the steps of the prediction, what models are trained and judged on.

A jump is sampled at the steps of a ``TimeGrid`` (25 ms in contact, 100 ms in flight); a window is K steps of that,
and slides by one step (paper, training). D = H (N − K + 1) windows for H jumps of N steps.
"""

import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.files import read_json, write_json
from leapgap.recording.jump import BASE_POSITION, BASE_QUATERNION, Jump
from leapgap.robot.model import Robot
from leapgap.robot.pair_force import per_axis
from leapgap.robot.schedule import PAIRS, ContactSchedule

FORMAT_VERSION = 1
STATE_COLUMNS = ("base_pos_x", "base_pos_z", *BASE_QUATERNION, "base_linvel_x", "base_linvel_z", "base_angvel_y")
NOON_OF_ZIP = (1980, 1, 1, 0, 0, 0)
"""One date for every member, so that equal arrays give equal bytes."""


@dataclass(frozen=True)
class TimeGrid:
    """Steps of the horizon: short while feet push, long in flight; ``steps`` of them (K) make a window."""

    contact_step_s: float = 0.025
    flight_step_s: float = 0.1
    steps: int = 10

    def __post_init__(self) -> None:
        if self.contact_step_s <= 0 or self.flight_step_s <= 0 or self.steps < 1:
            raise InputError("time grid", str(self), "steps longer than nothing, one or more", "correct conf/chunk")

    def contact_steps(self, schedule: ContactSchedule) -> int:
        """Steps of a whole jump that begin before take-off."""
        return whole_steps("time until take-off", schedule.take_off_s, self.contact_step_s)

    def jump_steps(self, schedule: ContactSchedule) -> int:
        """Steps of a whole jump (N): in contact, then in flight."""
        return self.contact_steps(schedule) + whole_steps("flight", schedule.flight_s, self.flight_step_s)

    def step_lengths(self, schedule: ContactSchedule) -> np.ndarray:
        """Length of each step of a whole jump, s, shape (N,)."""
        contact = np.arange(self.jump_steps(schedule)) < self.contact_steps(schedule)
        return np.where(contact, self.contact_step_s, self.flight_step_s)

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
        raise InputError(
            f"time grid, {phase}",
            f"{length_s:g} s, which is not a whole number of {step_s:g} s steps",
            f"for instance {shorter:g} s or {longer:g} s",
            "choose a step that divides the phase, or another schedule",
        )
    return round(steps)


@dataclass(frozen=True)
class RolloutInputs:
    """What a model may know of W windows of K steps: the first state, and what acts during the steps."""

    state: np.ndarray
    """First state: x z pitch and rates, m, rad, s; x from the window's start, z in the world; (W, 6)."""
    force: np.ndarray
    """Ground forces on the robot, front x z, rear x z, N, world axes; zero in flight; (W, K, 4)."""
    foot: np.ndarray
    """Foot − base, mean of the pair, front x z, rear x z, m, world axes; (W, K, 4)."""
    contact: np.ndarray
    """Whether each step begins before take-off, bool, (W, K)."""
    time_s: np.ndarray
    """When each step begins, since the start of the jump, (W, K)."""
    step_s: np.ndarray
    """Length of each step, (W, K)."""
    start: np.ndarray
    """Number of each window's first step in its jump, int, (W,)."""

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
    schedule: ContactSchedule | None
    """Of all jumps; ``None`` where there are none."""
    robot: str
    robot_sha256: str
    jumps: tuple[str, ...]
    jump: np.ndarray
    """Which of ``jumps`` each window is of, int, (W,)."""
    start: np.ndarray
    """Number of each window's first step in its jump, int, (W,)."""
    start_x: np.ndarray
    """World x of the base at each window's first sample, m, (W,)."""
    state: np.ndarray
    """Measured states: x z pitch and rates; x from the window's start, z in the world; (W, K + 1, 6)."""
    force: np.ndarray
    """As in ``RolloutInputs``, (W, K, 4)."""
    foot: np.ndarray
    """As in ``RolloutInputs``, (W, K, 4)."""
    time_s: np.ndarray
    """Of each sample since the start of the jump, (W, K + 1)."""
    contact: np.ndarray
    """Whether each step begins before take-off, bool, (W, K)."""

    def __len__(self) -> int:
        return len(self.jump)

    @property
    def inputs(self) -> RolloutInputs:
        """What a model may know of them: everything but the states after the first."""
        return RolloutInputs(
            state=self.state[:, 0],
            force=self.force,
            foot=self.foot,
            contact=self.contact,
            time_s=self.time_s[:, :-1],
            step_s=np.diff(self.time_s, axis=1),
            start=self.start,
        )

    def of_jumps(self, names: Sequence[str]) -> "Windows":
        """The windows of some of the jumps only, in their order here."""
        kept = tuple(name for name in self.jumps if name in set(names))
        number = {self.jumps.index(name): i for i, name in enumerate(kept)}
        mask = np.isin(self.jump, list(number))
        arrays = {name: getattr(self, name)[mask] for name in ARRAYS}
        arrays["jump"] = np.array([number[int(j)] for j in arrays["jump"]], dtype=int)
        return replace(self, jumps=kept, **arrays)


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
        """What models of these windows are for."""
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
                raise InputError(
                    where,
                    f"a model for {name} {mine}",
                    f"{name} {wanted}, as is needed here",
                    "train models for it (stages.chunk, stages.train), or use what they were trained for",
                )


def cut(jumps: Sequence[Jump], grid: TimeGrid, robot: Robot, force: str = "total") -> Windows:
    """Cut jump logs, which share one contact schedule, into windows; none gives valid windows without any.

    ``force``: which forces the windows carry, a key of ``FORCES``.
    """
    if force not in FORCES:
        raise InputError("chunk.force", force, f"one of {', '.join(FORCES)}", "correct conf/chunk")
    for jump in jumps[1:]:
        if jump.info.schedule != jumps[0].info.schedule:
            raise InputError(
                jump.name,
                str(jump.info.schedule),
                f"{jumps[0].info.schedule}, as in {jumps[0].name}",
                "keep jumps of different schedules in different folders",
            )
    schedule = jumps[0].info.schedule if jumps else None
    pieces = [cut_jump(jump, grid, robot, FORCES[force]) for jump in jumps] or [no_windows(grid)]
    arrays = {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}
    numbers = np.concatenate([np.full(len(piece["start"]), i) for i, piece in enumerate(pieces)])
    return Windows(grid, schedule, robot.name, robot.sha256, tuple(jump.name for jump in jumps), jump=numbers, **arrays)


def no_windows(grid: TimeGrid) -> dict[str, np.ndarray]:
    """The arrays of no jump at all."""
    k = grid.steps
    return {
        "start": np.zeros(0, int),
        "start_x": np.zeros(0),
        "state": np.zeros((0, k + 1, 6)),
        "force": np.zeros((0, k, 4)),
        "foot": np.zeros((0, k, 4)),
        "time_s": np.zeros((0, k + 1)),
        "contact": np.zeros((0, k), bool),
    }


def cut_jump(
    jump: Jump, grid: TimeGrid, robot: Robot, forces_of: Callable[[Jump], np.ndarray]
) -> dict[str, np.ndarray]:
    """The arrays of one jump's N − K + 1 windows, by their names in ``Windows``."""
    schedule = jump.info.schedule
    try:
        total, contact = grid.jump_steps(schedule), grid.contact_steps(schedule)
    except InputError as error:
        raise InputError(f"{jump.name}, {error.where}", error.found, error.expected, error.do) from None
    if grid.steps > total:
        raise InputError(
            jump.name,
            f"windows of {grid.steps} steps",
            f"{total} steps or fewer: all that this jump's schedule has",
            "shorten the window (chunk.steps), or make the steps shorter",
        )
    times = grid.sample_times(schedule)
    rows = rows_at(jump, times)
    state = states(jump)[rows]
    force = np.where(np.arange(total)[:, None] < contact, forces_of(jump)[rows[:-1]], 0.0)
    foot = feet(jump, robot, rows[:-1])
    start = np.arange(total - grid.steps + 1)
    step, sample = start[:, None] + np.arange(grid.steps), start[:, None] + np.arange(grid.steps + 1)
    window_state = state[sample]
    window_state[:, :, 0] -= state[start, 0][:, None]
    return {
        "start": start,
        "start_x": state[start, 0],
        "state": window_state,
        "force": force[step],
        "foot": foot[step],
        "time_s": times[sample],
        "contact": step < contact,
    }


def rows_at(jump: Jump, times_s: np.ndarray) -> np.ndarray:
    """The row of a log nearest to each time, none further than half a sample period; shape of ``times_s``."""
    clock, half = jump.time, jump.info.sample_period_s / 2 + 1e-6
    if times_s[-1] > clock[-1] + half:
        raise InputError(
            jump.name,
            f"a log that ends at {clock[-1]:g} s",
            f"one that reaches {times_s[-1]:g} s, the end of its scheduled flight",
            "log the whole jump, or correct the schedule in its metadata",
        )
    right = np.clip(np.searchsorted(clock, times_s), 1, len(clock) - 1)
    rows = np.where(times_s - clock[right - 1] < clock[right] - times_s, right - 1, right)
    far = np.flatnonzero(np.abs(clock[rows] - times_s) > half)
    if len(far):
        raise InputError(
            f"{jump.name}, column time",
            f"no row within {half * 1e3:.3g} ms of {times_s[far[0]]:g} s",
            f"a row every {jump.info.sample_period_s * 1e3:g} ms, the sample period of its metadata",
            "repair the log, or correct its sample_period_s",
        )
    return rows


def states(jump: Jump) -> np.ndarray:
    """x z pitch and their rates at every row, in the world, (rows, 6)."""
    missing = [column for column in STATE_COLUMNS if column not in jump]
    if missing:
        raise InputError(
            jump.name,
            f"no base state (no {', '.join(missing)})",
            "position, orientation and velocity of the base",
            "leave this log out: a model of the base cannot learn without",
        )
    columns = ("base_pos_x", "base_pos_z", "base_linvel_x", "base_linvel_z", "base_angvel_y")
    x, z, vx, vz, pitch_rate = jump.stack(columns).T
    return np.stack([x, z, jump.pitch, vx, vz, pitch_rate], axis=-1)


def total_forces(jump: Jump) -> np.ndarray:
    """Ground forces on the robot at every row, front x z, rear x z, N, (rows, 4): u = u_mpc + u_pd.

    A source that filtered them itself supplies ``train_force``.
    """
    sources = {name for name in ("train_force", "mpc_force", "pd_force") if jump.has_pair_force(name)}
    if "train_force" in sources:
        return jump.pair_force("train_force")
    if {"mpc_force", "pd_force"} <= sources:
        return jump.pair_force("mpc_force") + jump.pair_force("pd_force")
    found = f"only {', '.join(sources)}" if sources else "no column of them"
    raise InputError(
        jump.name,
        f"no forces ({found})",
        "train_force, or mpc_force and pd_force, of both pairs",
        "log them, or leave this log out",
    )


def planned_forces(jump: Jump) -> np.ndarray:
    """u_mpc alone, (rows, 4): what an MPC decides on; a model of it learns what joint PD will add."""
    if not jump.has_pair_force("mpc_force"):
        raise InputError(
            jump.name,
            "no planned forces (no mpc_force)",
            "mpc_force of both pairs",
            "log them, leave this log out, or set chunk.force=total",
        )
    return jump.pair_force("mpc_force")


FORCES: dict[str, Callable[[Jump], np.ndarray]] = {"total": total_forces, "planned": planned_forces}
"""Which force u of a log a model is trained on: all that acts, or what the MPC asks for."""


def feet(jump: Jump, robot: Robot, rows: np.ndarray) -> np.ndarray:
    """Foot − base, mean of each pair, front x z, rear x z, world axes, m, at some rows, (len(rows), 4)."""
    position = jump.stack(BASE_POSITION)[rows]
    joints = jump.per_joint("joint_pos", robot.joints)[rows]
    at = robot.feet_in_world(position, jump.stack(BASE_QUATERNION)[rows], joints) - position[:, None]
    count = per_axis([len(robot.feet_of_pair(pair)) for pair in PAIRS])
    return robot.per_pair(at) / count


def write(windows: Windows, folder: Path) -> None:
    """Write ``windows.npz`` and ``windows.json``; the same windows give the same bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    write_npz(folder / "windows.npz", {name: getattr(windows, name) for name in ARRAYS})
    write_json(
        folder / "windows.json",
        {
            "format_version": FORMAT_VERSION,
            "windows": len(windows),
            "jumps": list(windows.jumps),
            "note": "" if len(windows) else "no logs: nothing was cut",
            "grid": asdict(windows.grid),
            "schedule": asdict(windows.schedule) if windows.schedule else None,
            "robot": windows.robot,
            "robot_sha256": windows.robot_sha256,
        },
    )


def read(folder: Path) -> Windows:
    """Read what ``write`` wrote."""
    about = read_json(folder / "windows.json")
    if about.get("format_version") != FORMAT_VERSION:
        raise InputError(
            folder / "windows.json",
            f"format_version {about.get('format_version')}",
            str(FORMAT_VERSION),
            "run stages.chunk anew",
        )
    arrays = read_npz(folder / "windows.npz")
    try:
        return Windows(
            grid=TimeGrid(**about["grid"]),
            schedule=ContactSchedule(**about["schedule"]) if about["schedule"] else None,
            robot=about["robot"],
            robot_sha256=about["robot_sha256"],
            jumps=tuple(about["jumps"]),
            **arrays,
        )
    except (KeyError, TypeError) as error:
        raise InputError(
            folder, f"windows that do not fit ({error})", "windows of this version", "run stages.chunk anew"
        ) from None


def write_npz(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Like ``numpy.savez``, without the clock: equal arrays give equal bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            member = BytesIO()
            np.lib.format.write_array(member, np.ascontiguousarray(array), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy", NOON_OF_ZIP), member.getvalue())


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """Read arrays, never pickles; ``InputError`` where the file is absent or broken."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        raise InputError(path, "no such file", "arrays written by a stage", "run that stage first") from None
    except (ValueError, OSError, zipfile.BadZipFile) as error:
        raise InputError(path, f"no whole archive ({error})", "arrays written by a stage", "run it anew") from None
