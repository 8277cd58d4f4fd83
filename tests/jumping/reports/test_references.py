"""The page of planned jumps shows each where it is at its moments."""

import re

from leapgap.jumping.reports.references import PIXELS_PER_M, html, keyframes, moments
from leapgap.logs.log import write_log


def test_moments_are_those_of_the_schedule(reference):
    rows = moments(reference)
    assert rows["start"] == 0
    assert reference.time[rows["lift-off"]] == 0.8
    assert reference.time[rows["landing"]] == 1.2
    assert abs(reference["base_linvel_z"][rows["apex"]]) < 0.02


def test_feet_stand_on_the_ground_at_the_start_and_not_at_the_apex(reference, robot):
    pictures = dict(re.findall(r'data-moment="([^"]+)"><g.*?>(.*?)</g>', keyframes(reference, robot)))
    radius = robot.foot_radius[0] * PIXELS_PER_M

    def soles(name):
        return [float(y) + radius for y in re.findall(r'<circle cx="[^"]+" cy="([^"]+)"', pictures[name])]

    assert len(soles("start")) == len(robot.feet)
    assert max(abs(sole) for sole in soles("start")) < 0.5  # pixels, 2.6 mm
    assert max(soles("apex")) < -0.1 * PIXELS_PER_M


def test_page_repeats_and_says_what_holds(tmp_path, reference, robot):
    write_log(reference, tmp_path / "h00_d50.parquet")
    (tmp_path / "references.json").write_text(
        '[{"x_m": 0.5, "z_m": 0.0, "cost": 1698.38, "max_violation": 2e-8, "status": "ok", "file": "h00_d50.parquet"}]'
    )
    page = html(tmp_path, robot)
    assert page == html(tmp_path, robot)
    assert "1 planned jump" in page
    assert "cost 1698.4" in page
    assert page.count('data-moment="') == 4
