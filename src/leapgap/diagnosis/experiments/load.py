"""Motions with a known mass at a link."""

from dataclasses import dataclass

from leapgap.diagnosis.experiments.base import Experiment, Repetition
from leapgap.diagnosis.experiments.given import Given
from leapgap.diagnosis.experiments.plans import with_load
from leapgap.diagnosis.experiments.sines import FAST_HZ, SLOW_HZ, Sines, amplitude
from leapgap.effects.bodies import links_at
from leapgap.logs.log import Log

LOAD_SHARE = 0.6  # A known load, as a share of the mass of all that moves with the link that carries it


@dataclass(frozen=True)
class KnownLoad(Experiment):
    """Motions with a known mass at the centre of mass of a link, which the metadata of the logs state."""

    name = "load"
    cost = 3

    joint: str  # The joint that moves the link
    body: str
    mass_kg: float
    frequency_hz: float | None = None  # Of sines of all joints; None: the motions of the logs
    share: float = 1.0  # Amplitude of the sines, as a share of that without a load

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """At the last link of a robot that is held, in the motions of the logs and in sines of all joints."""
        robot, joint = given.robot, given.joints[-1]
        if robot.has_free_base:
            return []
        (link,) = links_at(robot, joint)
        body, mass = robot.model.body(link).name, float(f"{LOAD_SHARE * robot.model.body_subtreemass[link]:.2g}")
        frequencies = [None, SLOW_HZ, FAST_HZ] if given.has_gains and given.is_even else [None]
        return [cls(joint, body, mass, frequency) for frequency in frequencies] if mass > 0 else []

    def plans(self, given: Given) -> list[Log]:
        """Sines of all joints, or the logs' own commands, with the load in their metadata."""
        return [with_load(plan, {self.joint: self.mass_kg}) for plan in self.motion(given).plans(given)]

    def motion(self, given: Given) -> Experiment:
        """What the robot does with the load."""
        if self.frequency_hz is None:
            return Repetition()
        return Sines(
            given.joints, tuple(amplitude(j, self.frequency_hz, given) for j in given.joints), self.frequency_hz
        )

    def words(self, given: Given) -> str:
        """What to do, with the mass in kg, the body and the metadata to state."""
        return (
            f"{self.motion(given).words(given)}, with {self.mass_kg:g} kg fastened at the centre of mass of "
            f'{self.body} (metadata of these logs: "load": {{"{self.joint}": {self.mass_kg:g}}})'
        )

    @property
    def short(self) -> str:
        """Mass and body, in a few words."""
        sines = "" if self.frequency_hz is None else f", sines of {self.frequency_hz:g} Hz"
        return f"with {self.mass_kg:g} kg at {self.body}{sines}"
