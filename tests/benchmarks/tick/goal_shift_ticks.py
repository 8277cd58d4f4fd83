"""Kinds of ticks of a goal-shift jump that measures its stance late, and is kicked at 0.3 s."""

UPDATE_TICKS, STANCE_TICK, SUDDEN_TICK = 25, 49, 325
"""The kick shows at the update that is tick 325."""
KINDS = ("measures_stance", "decides", "watches", "updates", "others")
OWN = 36
"""Number of jumps that a robot learned from that practised."""


def kind_of(tick: int, updates: int) -> str:
    """What a tick does, by its number, in a jump with that many updates."""
    if tick < STANCE_TICK:
        return "measures_stance"
    if tick == STANCE_TICK:
        return "decides"
    if tick % UPDATE_TICKS or tick >= UPDATE_TICKS * updates:
        return "others"
    return "watches" if tick < SUDDEN_TICK else "updates"
