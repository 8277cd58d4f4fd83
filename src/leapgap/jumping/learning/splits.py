"""Which jumps train and which are held out: by whole jumps, never by windows."""

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from leapgap.errors import InputError


@dataclass(frozen=True)
class Split:
    """Jumps to train on and jumps to judge by."""

    name: str
    train: tuple[str, ...]
    held_out: tuple[str, ...]


def folds(jumps: Sequence[str], number: int) -> list[Split]:
    """Fold f holds out every ``number``-th jump from the f-th on, in the order given; fewer with fewer jumps."""
    number = min(number, len(jumps))
    return [hold_out(f"fold_{f}", jumps, jumps[f::number]) for f in range(number)] if number > 1 else []


def sessions(jumps: Sequence[str], groups: Sequence[Sequence[str]]) -> list[Split]:
    """One split a group of name patterns, which holds the whole group out.

    None where fewer than two groups have jumps, or where the session of some jump is not known; a jump in two
    groups is an ``InputError``.
    """
    members = [[jump for jump in jumps if any(fnmatchcase(jump, pattern) for pattern in group)] for group in groups]
    twice = [jump for jump in jumps if sum(jump in group for group in members) > 1]
    if twice:
        raise InputError(
            "train.sessions",
            f"{', '.join(twice)} in several sessions",
            "each jump in one session",
            "correct the patterns, or set train.sessions=null",
        )
    if sum(bool(group) for group in members) < 2 or sum(map(len, members)) < len(jumps):
        return []
    return [hold_out(f"session_{i}", jumps, group) for i, group in enumerate(members) if group]


def train_on_all(jumps: Sequence[str]) -> Split:
    """The split that trains on all jumps: its models are used, and judged on other jumps only."""
    return Split("all", tuple(jumps), ())


def hold_out(name: str, jumps: Sequence[str], held_out: Sequence[str]) -> Split:
    """The split that holds some jumps out and trains on the others."""
    return Split(name, tuple(jump for jump in jumps if jump not in held_out), tuple(held_out))
