"""Robot files that are broken, that ask for all memory there is, or that describe another world: messages, and soon."""

import os
import resource
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from leapgap.effects.bodies import GravityDirection
from leapgap.errors import InputError
from leapgap.robot import model_guard
from leapgap.robot.model import Robot

GEOM = '<geom size="0.1"/>'
LINK = f'<body name="link"><joint name="j" axis="0 1 0"/>{GEOM}</body>'
MOTORS = '<actuator><motor joint="j"/></actuator>'
FLOATING = f'<body name="base"><freejoint/>{GEOM}{LINK}</body>'


def mjcf(world: str = LINK, rest: str = MOTORS) -> str:
    """An arm of one joint, or another world."""
    return f'<mujoco model="m"><worldbody>{world}</worldbody>{rest}</mujoco>'


def body(attributes: str = "", joint: str = 'name="j"', geom: str = 'size="0.1"') -> str:
    """A body with one joint and one geom, as MJCF."""
    return f"<body {attributes}><joint {joint}/><geom {geom}/></body>"


def nested(tag: str, count: int, inner: str) -> str:
    """Elements in one another."""
    return f"<{tag}>" * count + inner + f"</{tag}>" * count


def replicate(*counts: object, inner: str = '<geom size="0.1"/>') -> str:
    """Replications in one another."""
    for count in counts:
        inner = f'<replicate count="{count}" offset="0.1 0 0">{inner}</replicate>'
    return inner


HFIELD = '<hfield name="h{}" nrow="2000" ncol="2000" size="1 1 1 1"/>'
TEN_TIMES = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 12))
LAUGHS = f'<?xml version="1.0"?><!DOCTYPE m [<!ENTITY e0 "ha">{TEN_TIMES}]><mujoco model="&e11;"/>'

REFUSED: dict[str, tuple[str, str]] = {
    "empty": ("", "an empty file"),
    "blank": ("  ", "no valid MuJoCo model"),
    "text": ("not a robot", "no valid MuJoCo model"),
    "no end": ("<mujoco><worldbody>", "no valid MuJoCo model"),
    "other top": ("<sdf><model/></sdf>", "no valid MuJoCo model"),
    "null bytes": ("<mujoco>\0</mujoco>", "no valid MuJoCo model"),
    "entities": (LAUGHS, "no valid MuJoCo model"),
    "unknown element": (mjcf("<bodi/>"), "no valid MuJoCo model"),
    "deep": (mjcf(nested("body", 1000, GEOM)), "more than 200 deep"),
    "replicate": (mjcf(LINK + replicate(10**9)), "replicate with count=1000000000"),
    "replicate in replicate": (mjcf(LINK + replicate(500, 500, 500)), "more than 200000 elements after replication"),
    "replicate a million times": (mjcf(LINK + replicate(1e30)), "replicate with count=1e+30"),
    "replicate of bodies": (mjcf(replicate(150, 150, 150, inner=LINK)), "more than 200000 elements after replication"),
    "bodies between quoted comment marks": (
        mjcf(f'{LINK}<geom name="<!--" size="0.1"/>{replicate(999, 999)}<geom name="-->" size="0.1"/>'),
        "no valid MuJoCo model",
    ),
    "bodies in a document type": (
        f'<!DOCTYPE mujoco [<!ENTITY a "]>{mjcf(LINK + replicate(999, 999))}<!-- ">]><mujoco/>',
        "no valid MuJoCo model (a document type",
    ),
    "another encoding": (
        f'<?xml version="1.0" encoding="utf-16"?>{mjcf(LINK + replicate(999, 999))}',
        "more than 200000 elements",
    ),
    "a namespace": (
        mjcf(LINK + replicate(999, 999)).replace("<mujoco ", '<mujoco xmlns="a" '),
        "more than 200000 elements",
    ),
    "a tag that does not end": ("<mujoco><worldbody " + '<a "' * 100_000, "a tag that does not end"),
    "nine million copies": (mjcf(LINK + replicate(3000, 3000)), "more than 200000 elements"),
    "user data times copies": (mjcf(replicate(1000), MOTORS + '<size nuser_geom="1000000"/>'), "a model of "),
    "user data of one times copies": (
        mjcf(f'<geom size="1" user="{"1 " * 200_000}"/>{replicate(1000)}', MOTORS),
        "a model of ",
    ),
    "keys times joints": (mjcf(replicate(100, inner=LINK), '<size nkey="1000000"/>'), "a model of "),
    "many height fields": (
        mjcf(rest=f"<asset>{''.join(HFIELD.format(i) for i in range(100))}</asset>{MOTORS}"),
        "a model of ",
    ),
    "beams of a camera": (
        mjcf(
            '<camera name="c" resolution="3000 3000"/>' + LINK,
            MOTORS + "<sensor>" + '<rangefinder camera="c"/>' * 50 + "</sensor>",
        ),
        "a model of ",
    ),
    "fine mesh": (
        mjcf(rest=MOTORS + '<asset><mesh name="x" builtin="supertorus" params="3000 .3 1 1"/></asset>'),
        "mesh with params=3000 .3 1 1",
    ),
    "time step of 100 ns": (mjcf(rest=MOTORS + '<option timestep="1e-7"/>'), "a time step of 1e-07 s"),
    "endless solver": (
        mjcf(rest=MOTORS + '<option iterations="1000000000" tolerance="0"/>'),
        "option iterations=1000000000",
    ),
    "reservation": (mjcf(rest=MOTORS + '<size njmax="20000"/>'), "a model of "),
    "range that ends before it begins": (
        mjcf(body(joint='name="j" limited="true" range="1 -1"')),
        "no valid MuJoCo model",
    ),
    "name of two lines": (
        mjcf(LINK.replace('"j"', '"j&#10;k"'), MOTORS.replace('"j"', '"j&#10;k"')),
        r"joint with name='j\nk'",
    ),
    "composite": (mjcf(f'{LINK}<body><composite type="cable" count="1000000 1 1"/></body>'), "composite with count"),
    "flexcomp": (mjcf(f'{LINK}<flexcomp name="f" type="grid" count="999 999 999"/>'), "flexcomp with count"),
    "height field": (
        mjcf(rest=MOTORS + '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>'),
        "hfield with nrow=100000, ncol=100000",
    ),
    "texture": (
        mjcf(rest='<asset><texture name="t" type="2d" builtin="flat" width="99999" height="99999"/></asset>'),
        "texture with width=99999, height=99999",
    ),
    "memory": (mjcf(rest=MOTORS + '<size memory="500G"/>'), "size with memory=500G"),
    "memory of exabytes": (mjcf(rest=MOTORS + '<size memory="4E"/>'), "size with memory=4E"),
    "user data": (mjcf(rest=MOTORS + '<size nuserdata="1000000000"/>'), "size with nuserdata"),
    "keys": (mjcf(rest=MOTORS + '<size nkey="1000000000"/>'), "size with nkey"),
    "user of bodies": (mjcf(rest=MOTORS + '<size nuser_body="1000000000"/>'), "size with nuser_body"),
    "sensor": (mjcf(rest=MOTORS + '<sensor><user dim="2000000000"/></sensor>'), "user with dim=2000000000"),
    "numeric": (mjcf(rest='<custom><numeric name="n" size="2000000000"/></custom>'), "numeric with size=2000000000"),
    "hull": (mjcf(rest='<asset><mesh name="x" maxhullvert="2000000000" builtin="sphere"/></asset>'), "maxhullvert"),
    "built-in mesh": (
        mjcf(rest='<asset><mesh name="x" builtin="sphere" params="99999999"/></asset>'),
        "mesh with params=99999999",
    ),
    "huge geom": (mjcf(body(geom='size="1e200"')), "body_mass with values that are not finite"),
    "huge mass": (mjcf(body(geom='size="1" mass="1e300"')), "body_mass with values"),
    "NaN size": (mjcf(body(geom='size="nan"')), "no valid MuJoCo model"),
    "NaN place": (mjcf(body('pos="nan 0 0"')), "body_pos with values that are not finite"),
    "infinite place": (mjcf(body('pos="inf 0 0"')), "body_pos with values that are not finite"),
    "NaN friction": (mjcf(body(geom='size="0.1" friction="nan 1 1"')), "geom_friction with values"),
    "infinite damping": (mjcf(body(joint='name="j" damping="inf"')), "dof_damping with values"),
    "NaN armature": (mjcf(body(joint='name="j" armature="nan"')), "dof_armature with values"),
    "NaN gravity": (mjcf(rest=MOTORS + '<option gravity="nan 0 0"/>'), "option gravity with values"),
    "NaN gear": (mjcf(rest='<actuator><motor joint="j" gear="nan"/></actuator>'), "actuator_gear with values"),
    "no time step": (mjcf(rest=MOTORS + '<option timestep="0"/>'), "a time step of 0 s"),
    "backwards": (mjcf(rest=MOTORS + '<option timestep="-1"/>'), "a time step of -1 s"),
    "long time step": (mjcf(rest=MOTORS + '<option timestep="1e6"/>'), "a time step of 1e+06 s"),
    "no mass": (mjcf(body(geom='size="0.1" mass="0"')), "no valid MuJoCo model"),
    "negative mass": (mjcf(body(geom='size="0.1" mass="-1"')), "no valid MuJoCo model"),
    "no body": (mjcf("", ""), "no actuator at any joint"),
    "no motor": (mjcf(rest=""), "no actuator at j"),
    "unnamed joints": (mjcf(body('name="arm"', "") + body("", ""), ""), "unnamed joints of the bodies arm, (no name)"),
    "two of one name": (mjcf(LINK + LINK), "no valid MuJoCo model"),
    "motor of nothing": (mjcf(rest='<actuator><motor joint="k"/></actuator>'), "no valid MuJoCo model"),
    "ball": (mjcf(body('name="b"', 'type="ball"') + LINK), "free or ball joints of the bodies b"),
    "two free bases": (mjcf(FLOATING + f'<body name="ball"><freejoint/>{GEOM}</body>'), "free or ball joints"),
    "sideways": (mjcf(FLOATING, MOTORS + '<option gravity="9.81 0 0"/>'), "gravity (9.81, 0, 0) m/s² for a robot with"),
    "upwards": (mjcf(FLOATING, MOTORS + '<option gravity="0 0 9.81"/>'), "gravity (0, 0, 9.81) m/s² for a robot with"),
    "none": (mjcf(FLOATING, MOTORS + '<option gravity="0 0 0"/>'), "gravity (0, 0, 0) m/s² for a robot with a free"),
    "switched off": (
        mjcf(FLOATING, MOTORS + '<option><flag gravity="disable"/></option>'),
        "gravity (0, 0, 0) m/s² for a robot with a free base",
    ),
    "no such mesh": (
        mjcf(body(geom='type="mesh" mesh="x"'), MOTORS + '<asset><mesh name="x" file="x.stl"/></asset>'),
        "no file x.stl",
    ),
    "password file as a mesh": (
        mjcf(body(geom='type="mesh" mesh="x"'), '<asset><mesh name="x" file="../../../../../../etc/passwd"/></asset>'),
        "found ",
    ),
    "password file as a part": (
        mjcf(rest=MOTORS + '<include file="/etc/passwd"/>'),
        "no valid MuJoCo model in /etc/passwd",
    ),
    "plugin": (mjcf(rest='<extension><plugin plugin="evil.so"/></extension>'), "no valid MuJoCo model"),
    "URDF: no link": ('<robot name="r"/>', "no actuator at any joint"),
    "URDF: circle": (
        '<robot name="r"><link name="a"/><link name="b"/>'
        '<joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint>'
        '<joint name="k" type="fixed"><parent link="b"/><child link="a"/></joint></robot>',
        "no valid MuJoCo model",
    ),
    "URDF: no such link": (
        '<robot name="r"><link name="a"/><joint name="j" type="continuous"><parent link="a"/><child link="z"/></joint>'
        "</robot>",
        "no valid MuJoCo model",
    ),
    "URDF: NaN mass": (
        '<robot name="r"><link name="a"/><link name="b"><inertial><mass value="nan"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint></robot>',
        "found ",
    ),
    "URDF: text for a mass": (
        '<robot name="r"><link name="a"><inertial><mass value="heavy"/></inertial></link></robot>',
        "no valid MuJoCo model",
    ),
    "URDF: template of xacro": (
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="a"/><link name="b"/></robot>',
        "a template with xacro:arg",
    ),
    "git-LFS keeps the model": ("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n", "git lfs pull"),
    "range that is no number": (
        mjcf(body(joint='name="j" range="nan 1" limited="true"')),
        "jnt_range with values that are not finite",
    ),
    "sensor that is cut off nowhere": (
        mjcf(rest=MOTORS + '<sensor><jointpos joint="j" cutoff="inf"/></sensor>'),
        "sensor_cutoff with values that are not finite",
    ),
    "URDF: joint of no kind": (
        '<robot name="r"><link name="a"/><link name="b"/>'
        '<joint name="j" type="magic"><parent link="a"/><child link="b"/></joint></robot>',
        "no valid MuJoCo model",
    ),
}


def png(width: int, height: int) -> bytes:
    """The head of a picture."""
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", width, height)


def sparse(path: Path) -> None:
    """A file of 300 GiB that takes no room."""
    with path.open("wb") as file:
        file.truncate(300 << 30)


TEXTURE = '<asset><texture name="t" type="2d" file="t.png"/></asset>'
TEXTURES = [f'<texture name="t{i}" type="2d" file="{i}.png"/>' for i in range(20)]
MESH = '<asset><mesh name="x" file="x.stl"/></asset>'
FILES: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "includes itself": (mjcf(rest='<include file="robot.xml"/>'), lambda _: None, "robot.xml includes robot.xml"),
    "includes in a circle": (
        mjcf(rest='<include file="a.xml"/>'),
        lambda d: [
            (d / n).write_text(f'<mujoco><include file="{o}"/></mujoco>')
            for n, o in (("a.xml", "b.xml"), ("b.xml", "a.xml"))
        ],
        "a.xml includes b.xml includes a.xml",
    ),
    "attaches itself": (
        mjcf(rest=MOTORS + '<asset><model name="m" file="robot.xml"/></asset>'),
        lambda _: None,
        "robot.xml includes robot.xml",
    ),
    "includes a bomb": (
        mjcf(rest='<include file="a.xml"/>'),
        lambda d: (d / "a.xml").write_text(mjcf(replicate(999, 999), "")),
        "more than 200000 elements",
    ),
    "includes a pipe": (mjcf(rest='<include file="a.xml"/>'), lambda d: os.mkfifo(d / "a.xml"), "no plain file"),
    "mesh is a pipe": (mjcf(rest=MOTORS + MESH), lambda d: os.mkfifo(d / "x.stl"), "no plain file"),
    "mesh is a folder": (mjcf(rest=MOTORS + MESH), lambda d: (d / "x.stl").mkdir(), "is a folder"),
    "mesh is a device": (mjcf(rest=MOTORS + MESH.replace("x.stl", "/dev/zero")), lambda _: None, "no plain file"),
    "mesh of 300 GiB": (mjcf(rest=MOTORS + MESH), lambda d: sparse(d / "x.stl"), "307200 MiB"),
    "picture of 10 terapixels": (
        mjcf(rest=MOTORS + TEXTURE),
        lambda d: (d / "t.png").write_bytes(png(9_999_999, 999_999)),
        "t.png of 9999999 × 999999 pixels",
    ),
    "mesh whose name holds a new line is a pipe": (
        mjcf(rest=MOTORS + MESH.replace("x.stl", "x\n.stl")),
        lambda d: os.mkfifo(d / "x\n.stl"),
        r"mesh with file='x\n.stl'",
    ),
    "mesh in the folder that a later part names is a pipe": (
        mjcf(rest=MOTORS + MESH + '<include file="a.xml"/>'),
        lambda d: (
            (d / "parts").mkdir(),
            os.mkfifo(d / "parts" / "x.stl"),
            (d / "a.xml").write_text('<mujoco><compiler meshdir="parts"/></mujoco>'),
        ),
        "no plain file",
    ),
    "attached a thousand times": (
        mjcf(
            LINK + replicate(1000, inner='<body><attach model="m" prefix="p"/></body>'),
            MOTORS + '<asset><model name="m" file="a.xml"/></asset>',
        ),
        lambda d: (d / "a.xml").write_text(mjcf(GEOM * 1000, "")),
        "elements after replication",
    ),
    "many pictures": (
        mjcf(rest=MOTORS + f"<asset>{''.join(TEXTURES)}</asset>"),
        lambda d: [(d / f"{i}.png").write_bytes(png(7000, 7000)) for i in range(20)],
        "a model of ",
    ),
    "mesh that git-LFS keeps": (
        mjcf(body(geom='type="mesh" mesh="x"'), MOTORS + MESH),
        lambda d: (d / "x.stl").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n"),
        "fetch it: git lfs pull",
    ),
    "mesh without triangles": (
        mjcf(body(geom='type="mesh" mesh="x"'), MOTORS + MESH),
        lambda d: (d / "x.stl").write_bytes(bytes(84)),
        "no valid MuJoCo model",
    ),
    "mesh that claims triangles": (
        mjcf(body(geom='type="mesh" mesh="x"'), MOTORS + MESH),
        lambda d: (d / "x.stl").write_bytes(bytes(80) + (2**31).to_bytes(4, "little") + bytes(500)),
        "no valid MuJoCo model",
    ),
}


@pytest.mark.parametrize("name", [*REFUSED, *FILES])
def test_a_robot_that_cannot_be_used_is_refused_soon(name: str, tmp_path: Path) -> None:
    text, *make, says = FILES.get(name) or REFUSED[name]
    path = tmp_path / "robot.xml"
    path.write_text(text)
    for beside in make:
        beside(tmp_path)
    began = time.monotonic()
    with pytest.raises(InputError) as refusal:
        Robot.load(path)
    assert says in str(refusal.value), str(refusal.value)
    assert name in FILES or str(refusal.value).startswith(f"{path}: ")
    assert time.monotonic() - began < 5.0


def test_a_model_that_compiles_for_ever_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo simulates a muscle to find its range, for as long as the file says."""
    monkeypatch.setattr(model_guard, "TRIAL_S", 2)
    path = tmp_path / "robot.xml"
    long = (
        '<compiler><lengthrange mode="all" inttotal="1e7" timestep="0.001" interval="1e7" uselimit="false"/></compiler>'
    )
    path.write_text(mjcf(rest=f'<actuator><muscle joint="j"/></actuator>{long}'))
    with pytest.raises(InputError, match="more memory or time than any robot's"):
        Robot.load(path)


def test_a_model_that_passed_is_counted_again_when_a_file_of_it_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Path] = []
    counted = model_guard.counted
    monkeypatch.setattr(model_guard, "counted", lambda path, text: (asked.append(path), counted(path, text))[1])
    path = tmp_path / "robot.xml"
    path.write_text(mjcf(rest=MOTORS + '<include file="a.xml"/>'))
    (tmp_path / "a.xml").write_text("<mujoco><option/></mujoco>")
    assert Robot.load(path).spec() and Robot.load(path).spec()
    assert len(asked) == 1
    (tmp_path / "a.xml").unlink()
    os.mkfifo(tmp_path / "a.xml")
    with pytest.raises(InputError, match="no plain file"):
        Robot.load(path)


def test_a_pipe_a_folder_and_a_device_are_no_robots(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.xml")
    for path in (tmp_path / "pipe.xml", tmp_path, Path("/dev/zero")):
        says = "a folder" if path == tmp_path else "no plain file"
        with pytest.raises(InputError, match=says):
            Robot.load(path)


def test_a_robot_file_of_300_gib_is_refused(tmp_path: Path) -> None:
    sparse(tmp_path / "robot.xml")
    with pytest.raises(InputError, match="64 MiB at most"):
        Robot.load(tmp_path / "robot.xml")


ACCEPTED = {
    "a comment that XML forbids": (mjcf(f"<!-- a -- b -->{LINK}"), ()),
    "an arm in space": (
        mjcf(rest=MOTORS + '<option gravity="0 0 0"/>'),
        ("gravity is (0, 0, 0) m/s², not 9.81 m/s² downwards",),
    ),
    "an arm in space by a flag": (
        mjcf(rest=MOTORS + '<option><flag gravity="disable"/></option>'),
        ("gravity is (0, 0, 0) m/s², not 9.81 m/s² downwards",),
    ),
    "an arm on a wall": (
        mjcf(rest=MOTORS + '<option gravity="9.81 0 0"/>'),
        ("gravity is (9.81, 0, 0) m/s², not 9.81 m/s² downwards",),
    ),
    "a robot on the moon": (
        mjcf('<geom type="plane" size="1 1 1"/>' + FLOATING, MOTORS + '<option gravity="0 0 -1.62"/>'),
        ("gravity is (0, 0, -1.62) m/s², not 9.81 m/s² downwards",),
    ),
    "a slope of 20 degrees by its gravity": (
        mjcf('<geom type="plane" size="1 1 1"/>' + FLOATING, MOTORS + '<option gravity="3.355 0 -9.218"/>'),
        ("gravity is (3.355, 0, -9.218) m/s², not 9.81 m/s² downwards",),
    ),
    "ten copies": (mjcf(LINK + replicate(10)), ()),
    "names beyond ASCII": (mjcf(LINK.replace('"j"', '"плечо"'), MOTORS.replace('"j"', '"плечо"')), ()),
}


@pytest.mark.parametrize("name", ACCEPTED)
def test_unusual_robots_are_taken_and_what_is_unusual_is_said(name: str, tmp_path: Path) -> None:
    text, notes = ACCEPTED[name]
    (tmp_path / "robot.xml").write_text(text)
    assert Robot.load(tmp_path / "robot.xml").notes == notes


def test_gravity_that_a_flag_switches_off_has_no_direction(tmp_path: Path) -> None:
    """The vector of the model file is still 9.81 m/s² downwards."""
    (tmp_path / "robot.xml").write_text(ACCEPTED["an arm in space by a flag"][0])
    assert GravityDirection.lacks(Robot.load(tmp_path / "robot.xml")) == "gravity"


def test_files_of_a_robot_may_lie_beside_its_folder(tmp_path: Path) -> None:
    """As those of many real robots do: what is refused is no plain file, wherever it lies."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "robots").mkdir()
    (tmp_path / "parts" / "motors.xml").write_text(f"<mujoco>{MOTORS}</mujoco>")
    path = tmp_path / "robots" / "robot.xml"
    path.write_text(mjcf(rest='<include file="../parts/motors.xml"/>'))
    assert Robot.load(path).joints == ("j",)


def test_the_bombs_take_no_memory(tmp_path: Path) -> None:
    """All of them, in a process that may have 1 GiB more than it needs for a robot."""
    names = ("replicate in replicate", "height field", "texture", "memory", "sensor", "numeric", "flexcomp", "entities")
    for number, name in enumerate(names):
        (tmp_path / f"{number}.xml").write_text(REFUSED[name][0])
    code = (
        "import sys, pathlib\n"
        "from leapgap.errors import InputError\n"
        "from leapgap.robot.model import Robot\n"
        "for path in sorted(pathlib.Path(sys.argv[1]).glob('*.xml')):\n"
        "    try: Robot.load(path)\n"
        "    except InputError: print('refused')\n"
    )
    limit = 3 << 30  # libraries claim 1.5 GiB of addresses

    def limits() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))

    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, preexec_fn=limits, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.split() == ["refused"] * len(names)
