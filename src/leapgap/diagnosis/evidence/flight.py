"""Where the centre of mass is, how fast it falls, and how hard the trunk turns, by the longest flight of each log."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from leapgap.diagnosis.evidence.base import LEAST_LOGS, Evidence, Source, agree, slopes, sure, told_model
from leapgap.effects.bodies import ComOffset, TrunkInertia
from leapgap.logs.contacts import has_feet_in_world, in_flight, longest_run
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.kinematics import centre_of_mass, momenta
from leapgap.robot.model import Robot

SHORTEST_S = 0.15  # A shorter flight turns the robot too little to tell where its centre of mass is
MARGIN_S = 0.02  # So much at both ends of a flight is left out: a foot may still touch
STRAIGHT_M = 0.001  # A flight in which the centre of mass leaves its parabola by more, rms, had a contact
RATES = ("base_angvel_x", "base_angvel_y", "base_angvel_z")
EXPLAINED = 0.5
"""The trunk's own part has to explain so large a share of how the angular momentum of the others changes."""
TOLD = 0.15  # The scale of the inertia is told where it scatters by less over the logs


class Flight(Source):
    """In the air nothing but gravity moves the centre of mass: forward evenly, up and down by a parabola.

    A trunk that turns while it flies would bend that path, were its centre of mass elsewhere than the model has it.
    """

    name = "flight"

    def gather(self, logs: Sequence[Log], robot: Robot, before: Sequence[Evidence] = ()) -> list[Evidence]:
        """Fit g and the offset of the trunk's centre of mass to the longest flight of each log.

        Offsets that the flights do not surely ask for keep the model's value, and the others are fitted anew.
        """
        if not all(has_feet_in_world(log, robot) for log in logs):
            return []
        parameters = ComOffset.parameters(robot)
        fits = fit_flights(logs, robot, np.ones(len(parameters), bool))
        if len(fits) < LEAST_LOGS:
            return []
        value, spread = agree_all(fits)
        kept = sure(value, spread)[1:]
        anew = fit_flights(logs, robot, kept)
        if len(anew) < LEAST_LOGS:  # without those offsets, which scatter from log to log, the flights are no parabolas
            return []
        again, its_spread = agree_all(anew)
        spread = np.where(np.append(True, kept), its_spread, spread)
        told = []
        names = ["gravity", *(f"{ComOffset.name}.{p.name}" for p in parameters)]
        for k, (quantity, unit) in enumerate(zip(names, ["m/s²", *(p.unit for p in parameters)], strict=True)):
            size = (
                f"{again[k]:.3f} ± {spread[k]:.3f} m/s²"
                if k == 0
                else f"{1000 * again[k]:.1f} ± {1000 * spread[k]:.1f} mm"
            )
            what = "the centre of mass falls with" if k == 0 else f"the trunk's centre of mass is off by ({quantity})"
            says = f"in flight {what} {size}"
            per_log = {log: float(fit[k]) for log, fit in anew.items()}
            told.append(Evidence(self.name, quantity, float(again[k]), float(spread[k]), unit, per_log, says))
        return told


def fit_flights(logs: Sequence[Log], robot: Robot, kept: np.ndarray) -> dict[str, np.ndarray]:
    """``fit_flight`` of each log with a clean flight, by the log's name."""
    return {log.name: fit for log in logs if (fit := fit_flight(log, robot, kept)) is not None}


def agree_all(fits: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Medians of the logs' numbers and their standard deviations, (numbers,) each."""
    numbers = range(len(next(iter(fits.values()))))
    of_numbers = [agree({log: float(fit[k]) for log, fit in fits.items()}) for k in numbers]
    return np.array([value for value, _ in of_numbers]), np.array([spread for _, spread in of_numbers])


def clean_flight(log: Log, robot: Robot) -> slice | None:
    """Rows of the longest flight of a log without its ends; None where it is short."""
    flight = longest_run(in_flight(log, robot))
    margin = log.info.rows(MARGIN_S)
    rows = slice(flight.start + margin, flight.stop - margin)
    return None if rows.stop - rows.start < log.info.rows(SHORTEST_S) else rows


def fit_flight(log: Log, robot: Robot, kept: np.ndarray) -> np.ndarray | None:
    """Gravity, then the parameters of ``com_offset``, by least squares; None where the log has no clean flight.

    Only the ``kept`` parameters, bool, (parameters,), are fitted; the others are 0.
    """
    rows = clean_flight(log, robot)
    if rows is None:
        return None
    qpos = motion_of(log, robot, rows).qpos

    def centres(model: mujoco.MjModel) -> np.ndarray:
        return centre_of_mass(robot, qpos, model)[:, [0, 2]]

    _, path, by = slopes(ComOffset, robot, centres)
    time = log.time[rows] - log.time[rows].mean()
    one, none = np.ones_like(time), np.zeros_like(time)
    # Unknown: two places, two velocities, g, then the offsets, which the path must not contain.
    forward = np.column_stack([one, time, none, none, none, -by[:, 0]])
    upward = np.column_stack([none, none, one, time, -(time**2) / 2, -by[:, 1]])
    matrix, right = np.concatenate([forward, upward]), np.concatenate([path[:, 0], path[:, 1]])
    free = np.append(np.ones(5, bool), kept)
    found = np.zeros(len(free))
    found[free], *_ = np.linalg.lstsq(matrix[:, free], right, rcond=None)
    straight = np.sqrt(np.mean((right - matrix @ found) ** 2)) < STRAIGHT_M
    return found[4:] if straight else None


class AngularMomentum(Source):
    """In the air the angular momentum about the centre of mass stays: legs that turn one way turn the trunk the other.

    How much the trunk turns for it tells its inertia, in units of the legs'. Where the legs are and where the trunk's
    centre of mass is has to be right, so evidence of these is taken first.
    """

    name = "angular_momentum"
    place = 1

    def gather(self, logs: Sequence[Log], robot: Robot, before: Sequence[Evidence] = ()) -> list[Evidence]:
        """Fit the scale of the trunk's inertia to the longest flight of each log."""
        if not all(has_feet_in_world(log, robot) and RATES[1] in log for log in logs):
            return []
        model = told_model(robot, before)
        fits = {log.name: fit for log in logs if (fit := inertia_in_flight(log, robot, model)) is not None}
        if len(fits) < LEAST_LOGS:
            return []
        value, spread = agree(fits)
        if spread > TOLD:
            return []
        says = f"in flight the trunk turns against the legs as with {value:.2f} ± {spread:.2f} times its inertia"
        (parameter,) = TrunkInertia.parameters(robot)
        value = value if sure(value - parameter.nominal, spread) else parameter.nominal
        return [Evidence(self.name, f"{TrunkInertia.name}.{parameter.name}", value, spread, "1", fits, says)]


def inertia_in_flight(log: Log, robot: Robot, model: mujoco.MjModel) -> float | None:
    """Scale of the trunk's inertia that keeps the angular momentum, by least squares; None without a clean flight.

    Only the axes of which the rate of the trunk was logged count.
    """
    rows = clean_flight(log, robot)
    if rows is None:
        return None
    motion = motion_of(log, robot, rows)
    heavier = model.__copy__()
    TrunkInertia(scale=2.0).change_model(heavier, robot)
    axes = [k for k, rate in enumerate(RATES) if rate in log]
    whole = momenta(robot, motion, model)[1][:, axes]
    trunk = momenta(robot, motion, heavier)[1][:, axes] - whole
    changes, by_trunk = (part - part.mean(axis=0) for part in (whole, trunk))
    departs = -float((by_trunk * changes).sum() / max((by_trunk**2).sum(), 1e-300))
    left, others = changes + departs * by_trunk, changes - by_trunk
    return 1 + departs if (left**2).sum() < (1 - EXPLAINED) * (others**2).sum() else None
