"""When the first jump of a run of stage ``land`` begins, since some methods stand before it."""

from leapgap.jumping.task import STAND
from leapgap.logs.log import Log


def jump_begin_s(run: Log) -> float:
    """Time from the first row to the begin of the first jump, s; 0 where the log states no stand before it."""
    segments = run.info.stated_segments
    return segments[0].end_s if segments and segments[0].name == STAND else 0.0
