"""Fits that could be true in place of the answer, which the next experiment is to tell apart from it."""

from dataclasses import dataclass

from leapgap.diagnosis.candidates import Candidate

PLACES = 2  # Number of rivals in the place of one cause that experiments are to tell apart


@dataclass(frozen=True)
class Rival:
    """A set of causes that could be true."""

    name: str  # Name of the effect that may be the one
    fit: Candidate


@dataclass(frozen=True)
class Undecided:
    """What an answer leaves open."""

    names: tuple[str, ...] = ()  # The first cause of the answer that has rivals, with these; empty where none has
    fits: tuple[Rival, ...] = ()  # The answer, and fits with the other names in its place; empty without an answer
    share: float = 0.0  # Probability of the likeliest rival
