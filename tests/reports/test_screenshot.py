import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from leapgap.errors import InputError
from leapgap.reports.log_recording import record_jump
from tests.reports.screenshot import screenshot

VULKAN_DRIVERS = [Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d")]
can_render = any(list(folder.glob("*.json")) for folder in VULKAN_DRIVERS if folder.is_dir())


@pytest.mark.skipif(not can_render, reason="no Vulkan driver: apt-get install mesa-vulkan-drivers")
def test_picture_shows_the_robot_at_the_asked_time(tmp_path, robot, hop):
    record_jump(tmp_path / "hop.rrd", hop, robot)
    pictures = []
    for at_s in (0.0, 0.4):
        screenshot(tmp_path / "hop.rrd", tmp_path / "hop.png", size=(900, 600), at_time_s=at_s)
        with Image.open(tmp_path / "hop.png") as picture:
            assert picture.size == (900, 600)
            pictures.append(np.asarray(picture.convert("RGB"), dtype=int))
    blue = [(p[:, :400, 2] > 90) & (p[:, :400, 0] < 110) & (p[:, :400, 2] - p[:, :400, 0] > 40) for p in pictures]
    heights = [np.nonzero(mask)[0].mean() for mask in blue]
    assert heights[1] < heights[0] - 15  # pixels count downwards: the robot is higher in mid-air
    assert {path.name for path in tmp_path.iterdir()} == {"hop.rrd", "hop.png"}
    running = [path.read_bytes() for path in Path("/proc").glob("[0-9]*/cmdline") if path.exists()]
    assert not any(str(tmp_path).encode() in line for line in running), "a viewer stays behind"


def test_no_recording_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        screenshot(tmp_path / "none.rrd", tmp_path / "none.png")


def test_a_viewer_that_ends_says_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "a.rrd").write_bytes(b"RRF2")
    start = subprocess.Popen
    dying = ["sh", "-c", "echo 'No graphics adapter was found' >&2; exit 1"]
    monkeypatch.setattr(subprocess, "Popen", lambda command, **more: start(dying, **more))
    with pytest.raises(InputError, match=r"No graphics adapter was found.*mesa-vulkan-drivers"):
        screenshot(tmp_path / "a.rrd", tmp_path / "a.png")
    assert not (tmp_path / "a.png").exists()
