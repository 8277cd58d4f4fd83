"""Which cases are withheld: kind, effects, sizes and places, drawn by seed and shuffled."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leapgap import effects
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.robot.model import Robot
from leapgap.validation.off_table import family

KINDS = ("single", "pair", "nameless", "none")


@dataclass(frozen=True)
class Half:
    """One half of the check: its seed, how many cases of each kind, and which nameless effects."""

    seed: int
    single: int
    pair: int
    nameless: int
    none: int
    families: list[str]
    """Names of the nameless effects that are drawn from."""


@dataclass(frozen=True)
class Case:
    """What is to be withheld; the numbers of everything else are drawn from the seed."""

    half: str
    kind: str
    effects: tuple[Effect, ...]
    seed: int
    """Of targets, blocks, nuisances and sensor noise: none of them knows the effects."""


Sizes = Mapping[str, Mapping[str, Sequence[float]]]
"""Effect → parameter → [least, most] departure from nominal; two negative numbers depart downwards."""


def draw_cases(halves: Mapping[str, Half], sizes: Sizes, signed: Sequence[str], robot: Robot) -> list[Case]:
    """All cases of all halves in shuffled order; ``signed`` effects depart to either side of nominal."""
    cases = []
    for name, half in sorted(halves.items()):
        rng = np.random.default_rng(half.seed)
        draw = Draw(sizes, signed, robot, rng)
        known = [str(n) for n in rng.permutation(sorted(set(effects.known()) & set(sizes)))]
        drawn: list[tuple[str, tuple[Effect, ...]]] = []
        drawn += [("single", (draw.one(known[i % len(known)]),)) for i in range(half.single)]
        drawn += [("pair", draw.two(known)) for _ in range(half.pair)]
        if half.nameless and not half.families:
            raise InputError(f"withhold.halves.{name}", "no families", "names of nameless effects", "list some")
        drawn += [("nameless", (draw.one(half.families[i % len(half.families)]),)) for i in range(half.nameless)]
        drawn += [("none", ())] * half.none
        cases += [Case(name, kind, own, int(rng.integers(2**31))) for kind, own in drawn]
    order = np.random.default_rng([half.seed for half in halves.values()]).permutation(len(cases))
    return [cases[i] for i in order]


@dataclass(frozen=True)
class Draw:
    """Random effects."""

    sizes: Sizes
    signed: Sequence[str]
    robot: Robot
    rng: np.random.Generator

    def one(self, name: str, least_share: float = 0.0) -> Effect:
        """One effect at a random place; its size evenly in the logarithm, above a share of the range."""
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
        location, values = self.place(kind.places), {}
        for p in kind.parameters(self.robot, location):
            value = np.clip(p.nominal + departures[p.name], p.lower, p.upper)
            values[p.name] = float(f"{value:.4g}")
        return kind(location=location, **values)

    def two(self, names: Sequence[str]) -> tuple[Effect, ...]:
        """Two effects of the table, none of them tiny."""
        first, second = self.rng.choice(names, 2, replace=False)
        return self.one(str(first), 0.5), self.one(str(second), 0.5)

    def place(self, places: str) -> str:
        """Everywhere in half the cases; else a pair, a joint group, a leg or a single joint or foot."""
        if places == "none" or self.rng.random() < 0.5:
            return "all"
        legs = tuple(dict.fromkeys(self.robot.limb_of(joint) for joint in self.robot.joints))
        kinds = [("front", "rear"), self.robot.joint_groups, legs, self.robot.joints]
        if places == "feet":
            kinds = [("front", "rear"), self.robot.feet]
        return str(self.rng.choice(kinds[self.rng.integers(len(kinds))]))
