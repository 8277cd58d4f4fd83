"""Limbs, groups, feet and pairs of robots whose files follow nobody's convention, written here by hand."""

from pathlib import Path

import pytest

from leapgap.errors import InputError
from leapgap.robot.model import Robot
from leapgap.robot.topology import PartNames


def link(joint: str, inside: str = "", pos: str = "0 0 -0.2", axis: str = "0 1 0") -> str:
    return (
        f'<body name="link of {joint}" pos="{pos}"><joint name="{joint}" axis="{axis}"/>'
        f'<geom size="0.02" contype="0" conaffinity="0"/>{inside}</body>'
    )


def robot(folder: Path, bodies: str, joints: list[str], names: PartNames | None = None) -> Robot:
    motors = "".join(f'<general joint="{joint}"/>' for joint in joints)
    path = folder / "robot.xml"
    path.write_text(f"<mujoco><worldbody>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>")
    return Robot.load(path, names=names)


def quadruped(joints: dict[str, tuple[str, str, str]], feet: bool = True) -> str:
    """A free base with four legs at its corners: leg → its three joints."""
    at = {"lf": "0.3 0.1 0", "rf": "0.3 -0.1 0", "lh": "-0.3 0.1 0", "rh": "-0.3 -0.1 0"}
    legs = ""
    for leg, (one, two, three) in joints.items():
        foot = f'<geom name="{leg.upper()} sole" pos="0 0 -0.2" size="0.02"/>' if feet else ""
        legs += link(one, link(two, link(three, foot)), at[leg], "1 0 0")
    return f'<body name="base"><freejoint/><geom size="0.1" contype="0" conaffinity="0"/>{legs}</body>'


ANYMAL_LIKE = {leg: (f"{leg}_HAA", f"{leg}_HFE", f"{leg}_KFE") for leg in ("lf", "rf", "lh", "rh")}
NUMBERED = {leg: (f"m{3 * i}", f"m{3 * i + 1}", f"m{3 * i + 2}") for i, leg in enumerate(("lf", "rf", "lh", "rh"))}


def test_the_a1_reads_as_its_names_say() -> None:
    a1 = Robot.load()
    assert tuple(a1.topology.limbs) == ("FR", "FL", "RR", "RL")
    assert a1.joint_groups == ("hip", "thigh", "calf")
    assert a1.limbs_of_pair == {"front": ("FR", "FL"), "rear": ("RR", "RL")}
    assert a1.topology.feet_of_limb["RL"] == ("RL",)


def test_front_and_rear_are_places_and_no_letters(tmp_path: Path) -> None:
    """A right front leg called ``rf`` is no rear leg."""
    names = [joint for of in ANYMAL_LIKE.values() for joint in of]
    found = robot(tmp_path, quadruped(ANYMAL_LIKE), names)
    assert found.limbs_of_pair == {"front": ("lf", "rf"), "rear": ("lh", "rh")}
    assert found.joint_groups == ("HAA", "HFE", "KFE")
    assert [found.joints[i] for i in found.joints_at("rf")] == ["rf_HAA", "rf_HFE", "rf_KFE"]
    assert [found.feet[i] for i in found.feet_at("rear")] == ["LH sole", "RH sole"]
    assert [found.feet[i] for i in found.feet_at("rh")] == ["RH sole"]
    assert found.limb_of("RH sole") == "rh"


def test_limbs_come_from_the_tree_where_names_say_nothing(tmp_path: Path) -> None:
    names = [joint for of in NUMBERED.values() for joint in of]
    found = robot(tmp_path, quadruped(NUMBERED), names)
    assert tuple(found.topology.limbs.values()) == tuple(NUMBERED.values())
    assert found.joint_groups == ()
    assert [found.joints[i] for i in found.joints_at("front")] == ["m0", "m1", "m2", "m3", "m4", "m5"]


def test_an_arm_is_one_limb_and_has_no_pairs(tmp_path: Path) -> None:
    joints = ["shoulder_pan_joint", "elbow_joint", "wrist_1_joint"]
    inside = link(joints[0], link(joints[1], link(joints[2])))
    found = robot(tmp_path, f'<body name="pedestal"><geom size="0.1"/>{inside}</body>', joints)
    assert tuple(found.topology.limbs.values()) == (tuple(joints),)
    assert not found.limbs_of_pair
    assert not found.joint_groups


def test_fingers_of_a_gripper_are_limbs_of_their_own(tmp_path: Path) -> None:
    joints = ["shoulder", "elbow", "finger_left", "finger_right"]
    hand = link("finger_left") + link("finger_right")
    found = robot(tmp_path, link("shoulder", link("elbow", hand)), joints)
    assert tuple(found.topology.limbs.values()) == (("shoulder", "elbow"), ("finger_left",), ("finger_right",))


def test_limbs_that_would_share_a_name_keep_apart(tmp_path: Path) -> None:
    """The left leg and the left arm of a biped: both begin with ``left``."""
    leg, arm = ("left_hip_pitch", "left_knee"), ("left_shoulder", "left_elbow")
    inside = link(leg[0], link(leg[1])) + link(arm[0], link(arm[1]))
    body = f'<body name="pelvis"><freejoint/><geom size="0.1"/>{inside}</body>'
    found = robot(tmp_path, body, [*leg, *arm])
    assert tuple(found.topology.limbs.values()) == (leg, arm)
    assert len(found.topology.limbs) == 2


def test_a_user_names_parts(tmp_path: Path) -> None:
    names = PartNames(limbs={"nose": ("m0", "m3"), "tail": ("m6",)}, groups={"outer": ("m2", "m5")}, feet=("RF sole",))
    found = robot(tmp_path, quadruped(NUMBERED), [j for of in NUMBERED.values() for j in of], names)
    assert [found.joints[i] for i in found.joints_at("nose")] == ["m0", "m3"]
    assert [found.joints[i] for i in found.joints_at("outer")] == ["m2", "m5"]
    assert found.feet == ("RF sole",)


@pytest.mark.parametrize(
    ("names", "odd"), [(PartNames(limbs={"x": ("m99",)}), "m99"), (PartNames(feet=("sole",)), "sole")]
)
def test_parts_the_model_does_not_have_are_refused(tmp_path: Path, names: PartNames, odd: str) -> None:
    with pytest.raises(InputError, match=f"parts made of {odd}"):
        robot(tmp_path, quadruped(NUMBERED), [j for of in NUMBERED.values() for j in of], names)


def test_a_place_nobody_has_is_refused_with_those_there_are(tmp_path: Path) -> None:
    found = robot(tmp_path, quadruped(ANYMAL_LIKE), [j for of in ANYMAL_LIKE.values() for j in of])
    with pytest.raises(InputError, match="one of all, front, rear, HAA"):
        found.joints_at("middle")
