"""References by target: a file serves the schedule it was planned for, and no other."""

from pathlib import Path

import pytest

from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.planning.reference import name_of, reference_to
from leapgap.jumping.task import ContactSchedule, Target, schedule_of
from leapgap.logs.log import write_log

TARGET = Target(0.4)


def test_a_file_serves_only_the_schedule_it_was_planned_for(tmp_path: Path) -> None:
    planned = reference_to(TARGET, tmp_path, PlanarRobot())
    write_log(planned, tmp_path / f"{name_of(TARGET)}.parquet")
    assert reference_to(TARGET, tmp_path, PlanarRobot()).info == planned.info
    short = ContactSchedule(0.5, 0.25, 0.35)
    found = reference_to(TARGET, tmp_path, PlanarRobot(), short)
    assert schedule_of(found) == short
    assert found.time[-1] == pytest.approx(1.1)
