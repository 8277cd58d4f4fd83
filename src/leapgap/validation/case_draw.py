"""The cases of the blind check: kind, effects, sizes and locations, drawn by seed and shuffled."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leapgap import effects
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.robot.model import Robot
from leapgap.validation.off_table import family

KINDS = ("single", "pair", "nameless", "none")
"""One effect of the table, two of them, one off-table effect, or no effect."""


@dataclass(frozen=True)
class Half:
    """One half of the check: its seed, how many cases of each kind, and which off-table effects."""

    seed: int
    single: int
    pair: int
    nameless: int
    none: int
    families: list[str]
    """Names of the off-table effects that are used in turn."""


@dataclass(frozen=True)
class Case:
    """The effects of a case, and the seed that everything else of it is drawn from."""

    half: str
    kind: str
    effects: tuple[Effect, ...]
    seed: int
    """Seed of targets, blocks, nuisances and sensor noise, which are thus independent of the effects."""


Sizes = Mapping[str, Mapping[str, Sequence[float]]]
"""Effect → parameter → [least, most] departure from nominal, in the parameter's unit; negative means downwards."""


def draw_cases(halves: Mapping[str, Half], sizes: Sizes, signed: Sequence[str], robot: Robot) -> list[Case]:
    """All cases of all halves in shuffled order; ``signed`` effects depart to either side of nominal."""
    cases = []
    for name, half in sorted(halves.items()):
        rng = np.random.default_rng(half.seed)
        sampler = EffectSampler(sizes, signed, robot, rng)
        known = [str(n) for n in rng.permutation(sorted(set(effects.known()) & set(sizes)))]
        drawn: list[tuple[str, tuple[Effect, ...]]] = []
        drawn += [("single", (sampler.sample(known[i % len(known)]),)) for i in range(half.single)]
        drawn += [("pair", sampler.sample_pair(known)) for _ in range(half.pair)]
        if half.nameless and not half.families:
            raise InputError(f"withhold.halves.{name}", "no families", "names of off-table effects", "list some")
        drawn += [("nameless", (sampler.sample(half.families[i % len(half.families)]),)) for i in range(half.nameless)]
        drawn += [("none", ())] * half.none
        cases += [Case(name, kind, own, int(rng.integers(2**31))) for kind, own in drawn]
    order = np.random.default_rng([half.seed for half in halves.values()]).permutation(len(cases))
    return [cases[i] for i in order]


@dataclass(frozen=True)
class EffectSampler:
    """Draws effects of random size at random locations; ``signed`` effects depart to either side of nominal."""

    sizes: Sizes
    signed: Sequence[str]
    robot: Robot
    rng: np.random.Generator

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
        location, values = self.sample_location(kind.places), {}
        for p in kind.parameters(self.robot, location):
            value = np.clip(p.nominal + departures[p.name], p.lower, p.upper)
            values[p.name] = float(f"{value:.4g}")
        return kind(location=location, **values)

    def sample_pair(self, names: Sequence[str]) -> tuple[Effect, ...]:
        """Draw two different effects of the table, each from the upper half of its logarithmic size range."""
        first, second = self.rng.choice(names, 2, replace=False)
        return self.sample(str(first), 0.5), self.sample(str(second), 0.5)

    def sample_location(self, places: str) -> str:
        """Draw a location: everywhere in half the cases, else a pair, a joint group, a leg, a single joint or foot."""
        if places == "none" or self.rng.random() < 0.5:
            return "all"
        legs = tuple(dict.fromkeys(self.robot.limb_of(joint) for joint in self.robot.joints))
        kinds = [("front", "rear"), self.robot.joint_groups, legs, self.robot.joints]
        if places == "feet":
            kinds = [("front", "rear"), self.robot.feet]
        return str(self.rng.choice(kinds[self.rng.integers(len(kinds))]))
