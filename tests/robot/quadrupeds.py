"""Go1 and Go2 by the figures of MuJoCo Menagerie (google-deepmind/mujoco_menagerie), without meshes."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Link:
    mass: float
    com: tuple[float, float, float]
    """Of the front right leg, m."""
    inertia: tuple[float, float, float]
    """About its own axes, kg·m²."""
    quat: tuple[float, float, float, float] = (1, 0, 0, 0)


@dataclass(frozen=True)
class Figures:
    """What tells one of these robots from another."""

    name: str
    base: str
    trunk: Link
    hip_at: tuple[float, float]
    thigh_y: float
    hip: Link
    thigh: Link
    calf: Link
    foot_x: float
    foot_radius: float
    thigh_range: dict[str, tuple[float, float]]
    calf_range: tuple[float, float]
    thigh_torque: float
    calf_torque: float
    torque_in: str
    """Where the file states the motors' limits: ``forcerange`` (position servos) or ``ctrlrange`` (motors)."""


GO1 = Figures(
    name="go1",
    base="trunk",
    trunk=Link(
        5.204,
        (0.0223, 0.002, -0.0005),
        (0.0716565, 0.0630105, 0.0168101),
        (-0.00342088, 0.705204, 0.000106698, 0.708996),
    ),
    hip_at=(0.1881, 0.04675),
    thigh_y=0.08,
    hip=Link(
        0.68,
        (-0.0049166, 0.00762615, -8.865e-05),
        (0.000734064, 0.000468438, 0.000398719),
        (0.507341, 0.514169, 0.495027, 0.482891),
    ),
    thigh=Link(
        1.009,
        (-0.00304722, 0.019315, -0.0305004),
        (0.00478717, 0.00460903, 0.000709268),
        (0.65243, -0.0272313, 0.0775126, 0.753383),
    ),
    calf=Link(
        0.195862,
        (0.00429862, 0.000976676, -0.146197),
        (0.00149767, 0.00148468, 3.58427e-05),
        (0.691246, 0.00357467, 0.00511118, 0.722592),
    ),
    foot_x=0.0,
    foot_radius=0.023,
    thigh_range={"front": (-0.686, 4.501), "rear": (-0.686, 4.501)},
    calf_range=(-2.818, -0.888),
    thigh_torque=23.7,
    calf_torque=35.55,
    torque_in="forcerange",
)
GO2 = Figures(
    name="go2",
    base="base",
    trunk=Link(
        6.921,
        (0.021112, 0, -0.005366),
        (0.107027, 0.0980771, 0.0244531),
        (-0.000543471, 0.713435, -0.00173769, 0.700719),
    ),
    hip_at=(0.1934, 0.0465),
    thigh_y=0.0955,
    hip=Link(
        0.678,
        (-0.0054, -0.00194, -0.000105),
        (0.00088403, 0.000596003, 0.000479967),
        (0.498237, 0.505462, 0.499245, 0.497014),
    ),
    thigh=Link(
        1.152,
        (-0.00374, 0.0223, -0.0327),
        (0.00594973, 0.00584149, 0.000878787),
        (0.551623, -0.0200632, 0.0847635, 0.829533),
    ),
    calf=Link(
        0.241352,
        (0.00629595, 0.000622121, -0.141417),
        (0.0014901, 0.00146356, 5.31397e-05),
        (0.703508, -0.00450087, 0.00154099, 0.710672),
    ),
    foot_x=-0.002,
    foot_radius=0.022,
    thigh_range={"front": (-1.5708, 3.4907), "rear": (-0.5236, 4.5379)},
    calf_range=(-2.7227, -0.83776),
    thigh_torque=23.7,
    calf_torque=45.43,
    torque_in="ctrlrange",
)
FIGURES = {figures.name: figures for figures in (GO1, GO2)}


def numbers(*values: float) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def inertial(link: Link, front: bool = True, left: bool = False, mirrored_x: bool = False) -> str:
    x, y, z = link.com
    com = numbers(x if front or not mirrored_x else -x, -y if left else y, z)
    inertia, quat = numbers(*link.inertia), numbers(*link.quat)
    return f'<inertial pos="{com}" mass="{link.mass}" diaginertia="{inertia}" quat="{quat}"/>'


def leg(f: Figures, name: str) -> str:
    front, left = name[0] == "F", name[1] == "L"
    side, ahead = (1 if left else -1), (1 if front else -1)
    low, high = f.thigh_range["front" if front else "rear"]
    return f"""
    <body name="{name}_hip" pos="{numbers(ahead * f.hip_at[0], side * f.hip_at[1], 0)}">
      {inertial(f.hip, front, left, mirrored_x=True)}
      <joint name="{name}_hip_joint" axis="1 0 0" damping="1" range="-0.863 0.863"/>
      <body name="{name}_thigh" pos="{numbers(0, side * f.thigh_y, 0)}">
        {inertial(f.thigh, front, left)}
        <joint name="{name}_thigh_joint" range="{numbers(low, high)}"/>
        <body name="{name}_calf" pos="0 0 -0.213">
          {inertial(f.calf, front, left)}
          <joint name="{name}_calf_joint" range="{numbers(*f.calf_range)}"/>
          <geom name="{name}" size="{f.foot_radius}" pos="{f.foot_x} 0 -0.213" priority="1" condim="3"/>
        </body>
      </body>
    </body>"""


def motor(f: Figures, name: str, group: str) -> str:
    torque = f.calf_torque if group == "calf" else f.thigh_torque
    limits = f'{f.torque_in}="{-torque} {torque}"'
    kind = "position kp='100'" if f.torque_in == "forcerange" else "motor"
    return f'<{kind} name="{name}_{group}" joint="{name}_{group}_joint" {limits}/>'


def mjcf(f: Figures) -> str:
    """The robot, with a floor."""
    legs = ("FR", "FL", "RR", "RL")
    return f"""
<mujoco model="{f.name}">
  <compiler angle="radian" autolimits="true"/>
  <option cone="elliptic" impratio="100" timestep="0.001"/>
  <default>
    <joint axis="0 1 0" damping="2" armature="0.01" frictionloss="0.2"/>
    <geom friction="0.8 0.02 0.01"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1"/>
    <body name="{f.base}" pos="0 0 0.445">
      {inertial(f.trunk)}
      <freejoint/>
      {"".join(leg(f, name) for name in legs)}
    </body>
  </worldbody>
  <actuator>
    {"".join(motor(f, name, group) for name in legs for group in ("hip", "thigh", "calf"))}
  </actuator>
</mujoco>"""


def write(figures: Figures, folder: Path) -> Path:
    path = folder / f"{figures.name}.xml"
    path.write_text(mjcf(figures))
    return path
