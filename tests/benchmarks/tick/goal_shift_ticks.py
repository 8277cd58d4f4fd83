"""Kinds of ticks of a goal-shift jump that measures its stance late."""

UPDATE_TICKS, STANCE_TICK = 25, 49
KINDS = ("measures_stance", "decides", "updates", "others")
OWN = 36
"""Number of jumps that a robot learned from that practised."""


def kind_of(tick: int, updates: int) -> str:
    """What a tick does, by its number, in a jump with that many updates."""
    if tick < STANCE_TICK:
        return "measures_stance"
    if tick == STANCE_TICK:
        return "decides"
    return "updates" if tick % UPDATE_TICKS == 0 and tick < UPDATE_TICKS * updates else "others"
