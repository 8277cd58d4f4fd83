"""The 3-D scene: floor, terrain and target, moving robots, their paths, and forces at the feet."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from leapgap.logs.metadata import segment_of_rows
from leapgap.logs.pair_force import WORLD_X_Z, by_pair
from leapgap.reports.plots import ground_friction, planned_to_push, split_at_take_off
from leapgap.reports.shown_robot import Colour, Recorder, ShownRobot
from leapgap.robot.kinematics import geom_rgba, visual_geoms
from leapgap.robot.terrain import Box
from leapgap.robot.topology import PAIRS

WORLD = "world"
METRES_PER_NEWTON = 0.001  # length of a force arrow: the A1's weight, 122 N, is 12 cm
FLOOR_MARGIN_M = 0.55
BELOW_M = 0.15  # distance of the floor below the bodies' origins of a robot that hangs lower than its base
FLOOR_COLOUR = (92, 98, 108)
LINE_COLOUR = (122, 128, 138)
BOX_COLOUR = (184, 158, 122)
TARGET_COLOUR = (240, 200, 60)
FORCES = {"mpc_force": (240, 70, 70), "pd_force": (240, 200, 60)}
GHOST_ALPHA = 70
CONE_HEIGHT_M = 0.12  # height of the friction cones, that of an arrow of the A1's weight
CONE_COLOUR = (150, 200, 90, 110)
RING_POINTS = 16


def log_scene(to: Recorder, actors: Sequence[ShownRobot]) -> None:
    """Log everything in 3-D for a set of robots; floor, terrain, target and forces are those of the first."""
    main = actors[0]
    to.static(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    log_ground(to, actors)
    for actor in actors:
        # Log the shapes of every body once, and its poses in the world as one set of columns
        poses, model = actor.poses, actor.robot.model
        for at, body in enumerate(actor.robot.bodies):
            entity = f"{WORLD}/{actor.key}/{poses.bodies[at]}"
            to.over_time(
                entity,
                actor.time,
                rr.Transform3D.columns(
                    translation=poses.positions[:, at].astype(np.float32),
                    quaternion=xyzw(poses.quaternions[:, at]).astype(np.float32),
                ),
            )
            # A body's shapes in its own axes: one batch for each kind on the body's entity, meshes below it
            geoms = visual_geoms(model, body)
            for i, geom in enumerate(geoms.pop("mesh", ())):  # Rerun places each by a transform
                mesh = model.geom_dataid[geom]
                first, first_face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
                turn = rr.Quaternion(xyzw=xyzw(model.geom_quat[geom]))
                place = rr.Transform3D(translation=model.geom_pos[geom], quaternion=turn)
                shape = rr.Mesh3D(
                    vertex_positions=model.mesh_vert[first : first + model.mesh_vertnum[mesh]],
                    triangle_indices=model.mesh_face[first_face : first_face + model.mesh_facenum[mesh]],
                    albedo_factor=shape_colour(geom, actor),
                )
                to.static(f"{entity}/mesh_{i}", place, shape)
            if geoms:
                to.static(entity, *(batch(kind, some, actor) for kind, some in geoms.items()))
        # Log the path of the base over the whole jump, and that of every foot as a thinner line
        faded = (*actor.colour, 110)
        to.static(
            f"{WORLD}/{actor.key}/way_of_base",
            rr.LineStrips3D([actor.poses.base.astype(np.float32)], radii=0.004, colors=actor.colour),
        )
        feet = actor.poses.feet.astype(np.float32)
        if feet.shape[1]:
            to.static(
                f"{WORLD}/{actor.key}/ways_of_feet",
                rr.LineStrips3D([feet[:, foot] for foot in range(feet.shape[1])], radii=0.0015, colors=faded),
            )
    log_forces(to, main)
    log_contacts(to, main)


def extent(actors: Sequence[ShownRobot]) -> np.ndarray:
    """Lowest and highest corner of all bodies' origins over all rows and of the target, m, (2, 3)."""
    points = np.concatenate([actor.poses.positions.reshape(-1, 3) for actor in actors])
    target = target_place(actors[0])
    if target is not None:
        points = np.concatenate([points, target[None]])
    return np.stack([points.min(axis=0), points.max(axis=0)])


def log_ground(to: Recorder, actors: Sequence[ShownRobot]) -> None:
    """Log a floor with a line every 10 cm, the terrain of the first log, and a bar at its target."""
    jump = actors[0].jump
    (left, right), (far, near), (lowest, _) = extent(actors).T
    # Height of the floor, m: zero, or below a robot that is fixed higher than its bodies hang
    height = 0.0 if actors[0].robot.has_free_base or lowest > -0.01 else float(lowest) - BELOW_M
    target_at = target_place(actors[0])
    low = np.floor(10 * np.array([left - FLOOR_MARGIN_M, far - 0.25])) / 10
    high = np.ceil(10 * np.array([right + FLOOR_MARGIN_M, near + 0.25])) / 10
    to.static(
        f"{WORLD}/floor",
        rr.Boxes3D(
            centers=[[*(low + high) / 2, height - 0.012]],
            sizes=[[*(high - low), 0.02]],
            colors=[FLOOR_COLOUR],
            fill_mode="solid",
        ),
    )
    along = np.arange(low[0], high[0] + 0.05, 0.1)
    across = np.arange(low[1], high[1] + 0.05, 0.1)
    lines = [[[x, low[1], height], [x, high[1], height]] for x in along]
    lines += [[[low[0], y, height], [high[0], y, height]] for y in across]
    to.static(f"{WORLD}/floor/lines_every_10_cm", rr.LineStrips3D(lines, radii=0.0012, colors=LINE_COLOUR))
    log_terrain(to, jump.info.terrain)
    if target_at is not None:
        aside = 0.25 * np.array([-np.sin(jump.yaw[0]), np.cos(jump.yaw[0]), 0.0])
        to.static(
            f"{WORLD}/target",
            rr.LineStrips3D(
                [[target_at - aside, target_at + aside]],
                radii=0.006,
                colors=TARGET_COLOUR,
                labels="target {x_m:g} m".format(**jump.info.extra["target"]),
                show_labels=True,
            ),
        )


def target_place(actor: ShownRobot) -> np.ndarray | None:
    """Target of the base on the surface there, m, (3,); None where the log has no base or states no target."""
    jump, target = actor.jump, actor.jump.info.extra.get("target")
    if target is None or not {"base_pos_x", "base_quat_w"} <= set(jump.columns):
        return None
    ahead = np.array([np.cos(jump.yaw[0]), np.sin(jump.yaw[0])])
    return np.array([*(actor.poses.base[0, :2] + target["x_m"] * ahead), target["z_m"] + 0.004])


def log_terrain(to: Recorder, boxes: Sequence[Box]) -> None:
    """Log the blocks on the floor; the label tells whether the height is an estimate."""
    if not boxes:
        return
    to.static(
        f"{WORLD}/terrain",
        rr.Boxes3D(
            centers=[[b.x_m, b.y_m, b.top_m - b.size_m[2] / 2] for b in boxes],
            sizes=[b.size_m for b in boxes],
            colors=[BOX_COLOUR] * len(boxes),
            labels=[f"{b.top_m * 100:.1f} cm" + (" (estimated)" if b.estimated else "") for b in boxes],
            show_labels=False,
            fill_mode="solid",
        ),
    )


def hide_robot(to: Recorder, actor: ShownRobot, after_s: float) -> None:
    """Hide a robot from a time on by a scale of 1e-5, which is invisible; Rerun refuses a scale of zero."""
    for body in actor.poses.bodies:
        to.over_time(
            f"{WORLD}/{actor.key}/{body}", np.array([after_s]), rr.Transform3D.columns(scale=[[1e-5, 1e-5, 1e-5]])
        )


def batch(kind: str, geoms: list[int], actor: ShownRobot) -> rr.AsComponents:
    """Shapes of one kind as Rerun draws them; spheres, which have one size, count as ellipsoids."""
    model = actor.robot.model
    size, centre, turn = model.geom_size[geoms], model.geom_pos[geoms], xyzw(model.geom_quat[geoms])
    look = {
        "quaternions": turn,
        "colors": [shape_colour(geom, actor) for geom in geoms],
        "fill_mode": rr.components.FillMode.Solid,
    }
    if kind == "box":
        return rr.Boxes3D(half_sizes=size, centers=centre, **look)
    if kind == "ellipsoid":
        half = np.where(size[:, 1:2] > 0, size, size[:, :1])
        return rr.Ellipsoids3D(half_sizes=half, centers=centre, **look)
    if kind == "cylinder":
        return rr.Cylinders3D(lengths=2 * size[:, 1], radii=size[:, 0], centers=centre, **look)
    # Start points of capsules for Rerun, m, (n, 3): one end of the axis, whereas MuJoCo states the centre
    x, y, z, w = turn.T
    axis = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)
    starts = centre - size[:, 1][:, None] * axis
    return rr.Capsules3D(lengths=2 * size[:, 1], radii=size[:, 0], translations=starts, **look)


def xyzw(wxyz: np.ndarray) -> np.ndarray:
    """Quaternions (…, 4) from MuJoCo's order w, x, y, z to Rerun's order x, y, z, w."""
    return np.roll(wxyz, -1, axis=-1)


def shape_colour(geom: int, actor: ShownRobot) -> tuple[int, ...]:
    """RGBA of a shape, 0–255: the model's colour tinted with the robot's; ghosts have only the robot's, translucent."""
    rgba = geom_rgba(actor.robot.model, geom)
    own, tint = 255 * rgba[:3], np.array(actor.colour)
    if actor.is_ghost:
        return (*actor.colour, int(GHOST_ALPHA * rgba[3]))
    mixed = 0.3 * own + 0.7 * tint * (0.55 + 0.45 * rgba[:3].mean())
    return (*(int(value) for value in mixed), int(255 * rgba[3]))


def log_forces(to: Recorder, actor: ShownRobot) -> None:
    """Log the forces of the pairs as arrows at the middle of each pair's feet.

    They are shown only while the pair is planned to push: in the air the forces of the joint PD move the leg and not
    the robot.
    """
    jump, robot = actor.jump, actor.robot
    pairs = [(i, [robot.feet.index(foot) for foot in robot.feet_of_pair(pair)]) for i, pair in enumerate(PAIRS)]
    if not all(feet for _, feet in pairs):
        return
    origins = np.stack([actor.poses.feet[:, feet].mean(axis=1) for _, feet in pairs], axis=1)
    # Whether the front and the rear pair are planned to push, bool, (rows, 2); both where no segment of the log is
    parts = split_at_take_off(jump.info.segments)
    segments = segment_of_rows(parts, actor.time)
    pushing = np.ones((len(actor.time), len(PAIRS)), dtype=bool)
    for k, part in enumerate(parts):
        pushing[segments == k] = planned_to_push(part)
    sources = [source for source in FORCES if jump.has_pair_force(source)]
    if sources:
        # Log the friction cone of each pair while it is planned to push: a force within it does not slip
        shape = cone_outline(ground_friction(actor.robot))
        entity = f"{WORLD}/{actor.key}/friction_cone"
        to.static(entity, rr.LineStrips3D.from_fields(colors=[CONE_COLOUR], radii=[0.0012]))
        strips = [origin + shape for origin in origins[pushing].astype(np.float32)]
        columns = rr.LineStrips3D.columns(strips=strips)
        to.over_time(entity, actor.time, columns.partition(pushing.sum(axis=1)))
    for source in sources:
        force = by_pair(jump.pair_force(source)[actor.rows])
        vectors = np.zeros((len(force), 2, 3))
        vectors[:, :, WORLD_X_Z] = METRES_PER_NEWTON * force
        entity = f"{WORLD}/{actor.key}/{source}"
        to.static(entity, rr.Arrows3D.from_fields(colors=[FORCES[source]], radii=[0.006]))
        columns = rr.Arrows3D.columns(
            vectors=vectors[pushing].astype(np.float32), origins=origins[pushing].astype(np.float32)
        )
        to.over_time(entity, actor.time, columns.partition(pushing.sum(axis=1)))


def cone_outline(friction: float) -> np.ndarray:
    """One line that draws a cone with its tip at 0: four edges and the rim, m, (points, 3)."""
    turn = 2 * np.pi * np.arange(RING_POINTS + 1) / RING_POINTS
    wide = friction * CONE_HEIGHT_M
    rim = np.stack([wide * np.cos(turn), wide * np.sin(turn), np.full(len(turn), CONE_HEIGHT_M)], axis=1)
    tip = np.zeros((1, 3))
    edges = [np.concatenate([tip, rim[i : i + 1]]) for i in range(0, RING_POINTS, RING_POINTS // 4)]
    return np.concatenate([*edges, tip, rim]).astype(np.float32)


def log_contacts(to: Recorder, actor: ShownRobot) -> None:
    """Log a point at every foot while its contact switch is closed."""
    feet = [i for i, foot in enumerate(actor.robot.feet) if f"contact/{foot}" in actor.jump]
    if not feet:
        return
    names = [f"contact/{actor.robot.feet[i]}" for i in feet]
    closed = actor.jump.stack(names)[actor.rows] > 0
    entity = f"{WORLD}/{actor.key}/measured_contact"
    colour: Colour = TARGET_COLOUR
    to.static(entity, rr.Points3D.from_fields(colors=[colour], radii=[0.024]))
    points = actor.poses.feet[:, feet][closed].astype(np.float32)
    to.over_time(entity, actor.time, rr.Points3D.columns(positions=points).partition(closed.sum(axis=1)))
