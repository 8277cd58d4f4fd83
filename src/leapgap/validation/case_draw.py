"""The cases of the benchmark: kind, effects, sizes and locations, drawn by seed and shuffled."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap import effects
from leapgap.diagnosis.hypotheses import places, usable
from leapgap.effects.base import Effect, Parameter
from leapgap.errors import InputError
from leapgap.robot.model import Robot
from leapgap.validation.generator import OTHERS, USUAL, Physics
from leapgap.validation.off_table import family
from leapgap.validation.uneven_rows import ClockFamily, limbs_of

GRAVITY = 9.81


@dataclass(frozen=True)
class OwnNumbers:
    """Numbers of one robot in the pose that its motions start from."""

    torque: np.ndarray  # largest torque of the motor of each joint, N·m, (joints,)
    inertia: np.ndarray  # that each motor turns where no other joint moves, with armature, kg·m², (joints,)
    mass: float  # of the whole robot, kg
    length: float  # height of a free base above the ground, or how far the links of a held robot are from its base, m
    period: float  # time between two commands of its motions, s

    @staticmethod
    def of(robot: Robot, state: np.ndarray, period_s: float) -> "OwnNumbers":
        """Those of a robot in a state (nq + nv,); ``InputError`` where its model states no limit of a motor."""
        if not np.isfinite(robot.torque_limits).all():
            without = [j for j, t in zip(robot.joints, robot.torque_limits, strict=True) if not np.isfinite(t)]
            expected = "a limit of the torque of every motor, of which sizes are shares"
            raise InputError(robot.path, f"no limit at {', '.join(without)}", expected, "state them in the model file")
        model, data = robot.model, mujoco.MjData(robot.model)
        data.qpos[:] = state[: model.nq]
        mujoco.mj_forward(model, data)
        whole = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, whole)
        arms = data.xipos[list(robot.bodies)] - data.xpos[robot.bodies[0]]
        height = float(data.xpos[robot.base_body, 2]) - robot.ground_height
        length = height if robot.has_free_base else float(np.linalg.norm(arms, axis=1).max())
        inertia = whole.diagonal()[robot.joint_dofs]
        return OwnNumbers(robot.torque_limits, inertia, robot.total_mass, length, period_s)

    def unit(self, p: Parameter, joints: np.ndarray) -> float:
        """The own number that a parameter of an effect at these joints is a share of, in the unit of the parameter.

        The weakest motor and the least inertia count, so that one value suits all joints. Where the model has a value
        of its own of a mass, a time or a factor, it is that; 1 for angles and factors.
        """
        torque, own = float(self.torque[joints].min()), None if p.scale in (0.0, 1.0) else p.scale
        by_unit = {
            "N·m": torque,
            "N·m/rad": torque,
            "N·m·s/rad": torque,
            "kg·m²": float(self.inertia[joints].min()),
            "kg": own or self.mass,
            "m": self.length,
            "s": own or self.period,
            "N": self.mass * GRAVITY,
            "N/m": self.mass * GRAVITY / self.length,
        }
        return by_unit.get(p.unit, own or 1.0)


KINDS = ("single", "pair", "nameless", "none", "triple")
"""One effect of the table, two of them, one off-table effect, no effect, or three effects of the table."""
FURTHER_KINDS = ("uneven", "third", "too_high")
"""Rows that are not what they claim, with an effect of the table or without; an effect or none in a third physics; a
model whose joint friction, damping or armature is larger than the robot's."""


@dataclass(frozen=True)
class Half:
    """One half of the check: its seed, how many cases of each kind, and which off-table effects."""

    seed: int
    single: int
    pair: int
    nameless: int
    none: int
    families: list[str]  # names of the off-table effects that are used in turn
    triple: int = 0


@dataclass(frozen=True)
class Case:
    """The effects of a case, and the seed that everything else of it is drawn from."""

    half: str
    kind: str
    effects: tuple[Effect, ...]
    seed: int  # seed of targets, blocks, nuisances and sensor noise, which are thus independent of the effects
    clock: ClockFamily | None = None  # how rows come to be what they do not claim; None: they are what they claim
    physics: Physics = USUAL


Sizes = Mapping[str, Mapping[str, Sequence[float]]]
"""Effect → parameter → [least, most] departure from nominal, in the parameter's unit; negative means downwards."""


@dataclass(frozen=True)
class FurtherCounts:
    """How many cases of each further kind a half has."""

    uneven: int
    third: int
    too_high: int


@dataclass(frozen=True)
class FurtherKinds:
    """What is drawn for the further kinds."""

    counts: Mapping[str, FurtherCounts]  # half → numbers of cases; none of a half that is not there
    clocks: Sizes  # clock family → size → [least, most], its logarithm drawn evenly; families take turns in this order
    too_high: Sizes  # effect → parameter → [least, most] share of the model's own value that the robot has, evenly


def draw_cases(
    halves: Mapping[str, Half],
    sizes: Sizes,
    signed: Sequence[str],
    robot: Robot,
    further: FurtherKinds | None = None,
    chosen: Sequence[Case] = (),
) -> list[Case]:
    """All cases of all halves; ``signed`` effects depart to either side of nominal.

    The ordinary kinds and ``chosen`` cases come first in shuffled order, then the further kinds, shuffled too. Every
    further kind is drawn by a generator of its own, so that the ordinary cases of a seed stay what they are.
    """
    cases = draw_ordinary_cases(halves, sizes, signed, robot, chosen=chosen)
    later: list[Case] = []
    for name, half in sorted(halves.items()):
        if further is None or name not in further.counts:
            continue
        counts = further.counts[name]
        sources = [np.random.default_rng([half.seed, 1 + k]) for k in range(len(FURTHER_KINDS))]
        samplers = [EffectSampler(sizes, signed, robot, rng) for rng in sources]
        later += uneven_cases(name, counts.uneven, samplers[0], further.clocks)
        later += third_cases(name, counts.third, samplers[1])
        later += too_high_cases(name, counts.too_high, samplers[2], further.too_high)
    order = np.random.default_rng([*(half.seed for half in halves.values()), 1]).permutation(len(later))
    return cases + [later[i] for i in order]


def draw_ordinary_cases(
    halves: Mapping[str, Half],
    sizes: Sizes,
    signed: Sequence[str],
    robot: Robot,
    own: OwnNumbers | None = None,
    chosen: Sequence[Case] = (),
) -> list[Case]:
    """The cases of the ordinary kinds of all halves, and the ``chosen`` ones, in shuffled order.

    With ``own`` the sizes are shares of the robot's own numbers, and effects that do not exist on it are not drawn.
    """
    cases = []
    for name, half in sorted(halves.items()):
        rng = np.random.default_rng(half.seed)
        sampler = EffectSampler(sizes, signed, robot, rng, own)
        existing = {effect for effect, kind in effects.known().items() if usable(kind, robot)}
        known = [str(n) for n in rng.permutation(sorted(existing & set(sizes)))]
        drawn: list[tuple[str, tuple[Effect, ...]]] = []
        drawn += [("single", (sampler.sample(known[i % len(known)]),)) for i in range(half.single)]
        drawn += [("pair", sampler.sample_several(known, 2)) for _ in range(half.pair)]
        if half.nameless and not half.families:
            raise InputError(f"withhold.halves.{name}", "no families", "names of off-table effects", "list some")
        # Refuse off-table effects that do not exist on a robot
        for one in half.families:
            lacking = family(one).lacks(robot)
            if lacking is not None:
                raise InputError("families", f"{one}, for which {robot.name} lacks {lacking}", "others", "take it out")
        drawn += [("nameless", (sampler.sample(half.families[i % len(half.families)]),)) for i in range(half.nameless)]
        drawn += [("none", ())] * half.none
        drawn += [("triple", sampler.sample_several(known, 3)) for _ in range(half.triple)]
        cases += [Case(name, kind, own, int(rng.integers(2**31))) for kind, own in drawn]
    cases += chosen
    order = np.random.default_rng([half.seed for half in halves.values()]).permutation(len(cases))
    return [cases[i] for i in order]


def uneven_cases(half: str, count: int, sampler: "EffectSampler", clocks: Sizes) -> list[Case]:
    """Cases of uneven rows, the families in turn; in every other case an effect of the table acts besides."""
    names, families, cases = steady_effects(sampler), list(clocks), []
    if count and not families:
        raise InputError("withhold.clocks", "no families", "one or more", "list some")
    for i in range(count):
        clock = sampler.sample_clock(families[i % len(families)], clocks)
        own = (sampler.sample(names[i % len(names)], 0.5),) if alternates(i, len(families)) else ()
        cases.append(Case(half, "uneven", own, int(sampler.rng.integers(2**31)), clock))
    return cases


def third_cases(half: str, count: int, sampler: "EffectSampler") -> list[Case]:
    """Cases of a third physics, each of them in turn; in every other case one effect of the table acts."""
    names, every, cases = steady_effects(sampler), list(OTHERS.values()), []
    for i in range(count):
        physics = every[i % len(every)]
        free = [effect for effect in names if effect not in physics.accepted]
        own = () if alternates(i, len(every)) else (sampler.sample(free[i % len(free)]),)
        cases.append(Case(half, "third", own, int(sampler.rng.integers(2**31)), None, physics))
    return cases


def too_high_cases(half: str, count: int, sampler: "EffectSampler", too_high: Sizes) -> list[Case]:
    """Cases of robots with less friction, damping or armature than the model, each effect in turn."""
    names, cases = sorted(too_high), []
    if count and not names:
        raise InputError("withhold.too_high", "no effects", "one or more", "list some")
    for i in range(count):
        own = (sampler.sample_reduction(names[i % len(names)], too_high),)
        cases.append(Case(half, "too_high", own, int(sampler.rng.integers(2**31))))
    return cases


def alternates(number: int, turns: int) -> bool:
    """True for every other number, and in every other round of so many turns for the numbers between."""
    return (number % turns + number // turns) % 2 == 0


def steady_effects(sampler: "EffectSampler") -> list[str]:
    """Effects of the table that do not differ from log to log, in random order."""
    known = effects.known()
    names = sorted(name for name in set(known) & set(sampler.sizes) if not known[name].differs_per_log)
    return [str(name) for name in sampler.rng.permutation(names)]


@dataclass(frozen=True)
class EffectSampler:
    """Draws effects of random size at random locations; ``signed`` effects depart to either side of nominal.

    With ``own``, ``sizes`` are shares of these numbers of the robot, and locations are places that its tree has.
    """

    sizes: Sizes
    signed: Sequence[str]
    robot: Robot
    rng: np.random.Generator
    own: OwnNumbers | None = None

    def unit(self, parameter: Parameter, kind: type[Effect], location: str) -> float:
        """What one of ``sizes`` is, in the unit of the parameter."""
        if self.own is None:
            return 1.0
        joints = self.robot.joints_at(location if kind.places == "joints" else "all")
        return self.own.unit(parameter, joints)

    def sample(self, name: str, least_share: float = 0.0) -> Effect:
        """Draw one effect at a random location.

        The logarithm of its size is uniform over the range in ``sizes``, of which the lowest ``least_share`` is left
        out.
        """
        kind = effects.known().get(name) or family(name)
        if name not in self.sizes:
            raise InputError("withhold.sizes", f"nothing for {name}", "a range for every effect", "add it")
        departures = {}
        for parameter in kind.declarations():
            least, most = self.sizes[name][parameter]
            departure = least * (most / least) ** self.rng.uniform(least_share, 1)
            if name in self.signed and self.rng.random() < 0.5:
                departure = -departure
            departures[parameter] = departure
        location, values = self.sample_location(kind), {}
        for p in kind.parameters(self.robot, location):
            value = np.clip(p.nominal + departures[p.name] * self.unit(p, kind, location), p.lower, p.upper)
            values[p.name] = float(f"{value:.4g}")
        return kind(location=location, **values)

    def sample_several(self, names: Sequence[str], number: int) -> tuple[Effect, ...]:
        """Draw so many different effects of the table, each from the upper half of its logarithmic size range."""
        return tuple(self.sample(str(name), 0.5) for name in self.rng.choice(names, number, replace=False))

    def sample_clock(self, name: str, sizes: Sizes) -> ClockFamily:
        """Draw the sizes of a clock family."""
        if name not in sizes:
            raise InputError("withhold.clocks", f"nothing for {name}", "a range for every clock family", "add it")
        drawn = {key: least * (most / least) ** self.rng.uniform(0, 1) for key, (least, most) in sizes[name].items()}
        return ClockFamily(name, {key: float(f"{value:.4g}") for key, value in drawn.items()})

    def sample_reduction(self, name: str, shares: Sizes) -> Effect:
        """Draw an effect, somewhere, that leaves the robot a share of what the model has of its own."""
        kind = effects.known()[name]
        location = self.sample_location(kind)
        left = {key: self.rng.uniform(least, most) for key, (least, most) in shares[name].items()}
        values = {p.name: (left[p.name] - 1) * p.scale for p in kind.parameters(self.robot, location)}
        return kind(location=location, **{key: float(f"{value:.4g}") for key, value in values.items()})

    def sample_location(self, kind: type[Effect]) -> str:
        """Draw a location: everywhere in half the cases, else a pair, a joint group, a leg, a single joint or foot."""
        if self.own is not None:
            others = [place for place in places(kind, self.robot) if place != "all"]
            return "all" if not others or self.rng.random() < 0.5 else str(self.rng.choice(others))
        if kind.places == "none" or self.rng.random() < 0.5:
            return "all"
        kinds = [("front", "rear"), self.robot.joint_groups, limbs_of(self.robot), self.robot.joints]
        if kind.places == "feet":
            kinds = [("front", "rear"), self.robot.feet]
        return str(self.rng.choice(kinds[self.rng.integers(len(kinds))]))
