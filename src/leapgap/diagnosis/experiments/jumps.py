"""Further jumps to the logged distances, with the front feet on low and high blocks."""

from dataclasses import dataclass, replace

from leapgap.diagnosis.experiments.base import Experiment
from leapgap.diagnosis.experiments.given import Given
from leapgap.diagnosis.experiments.plans import plan_of, with_start
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.simulation.open_loop import Course, MotionPlan, raise_front, with_block

OTHER_BLOCKS_M, MOST_FURTHER_JUMPS = (0.02, 0.08), 8


@dataclass(frozen=True)
class OtherJumps(Experiment):
    """Jumps to the logged distances with the front feet on low and high blocks.

    Jumps to other distances need plans that nobody has simulated yet, of which the longest slip at take-off.
    """

    name = "jumps"
    cost = 1

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """Possible where every log is a jump to a stated target."""
        return [cls()] if given.is_jumps else []

    @staticmethod
    def distances(given: Given) -> list[float]:
        """Distances of the logged jumps without doubles, m."""
        return sorted({float(log.info.extra["target"]["x_m"]) for log in given.logs})

    def number(self, given: Given) -> int:
        """How many jumps to make: twice as many as were logged, if that is not too many."""
        return max(len(self.distances(given)), min(2 * len(given.logs), MOST_FURTHER_JUMPS))

    def is_alike(self, given: Given) -> bool:
        """Always: they are jumps by the same plans."""
        return True

    def plans(self, given: Given) -> list[Log]:
        """The logged jumps on low and high blocks in turn."""
        robot, found = given.robot, []
        for k, log in enumerate(given.logs):
            height = OTHER_BLOCKS_M[k % len(OTHER_BLOCKS_M)]
            under = max((box.top_m for box in log.info.terrain), default=0.0)
            bare = replace(log, info=replace(log.info, terrain=()))
            block = with_block(bare, MotionPlan("", bare, height), robot, Course())
            state = raise_front(motion_of(log, robot, slice(1)).first_state, height - under, robot)
            found.append(with_start(plan_of(block, k, robot), state, robot))
        return found

    def words(self, given: Given) -> str:
        """What to do, with distances and heights of blocks in cm."""
        low, high = OTHER_BLOCKS_M
        centimetres = ", ".join(f"{100 * x:g}" for x in self.distances(given))
        return (
            f"record {self.number(given)} further jumps, to {centimetres} cm, with the front feet on blocks "
            f"of {100 * low:g} to {100 * high:g} cm"
        )

    @property
    def short(self) -> str:
        """That the blocks differ, in a few words."""
        return "on other blocks"

    def collect(self, given: Given) -> list[str]:
        """Settings of ``stages.collect`` that make such jumps on simulated hardware."""
        low, high = OTHER_BLOCKS_M
        targets = ",".join(f"[{x:g},0.0]" for x in self.distances(given))
        jumps = f"collect.jumps={self.number(given)}"
        return [f"collect.targets=[{targets}]", jumps, f"collect.block_height_m=[{low:g},{high:g}]"]
