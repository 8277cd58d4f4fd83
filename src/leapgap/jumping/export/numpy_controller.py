"""Goal-shift MPC of one jump with NumPy alone, by the tables beside it; the C code beside it does the same.

controller = Controller("folder of the export")
command = controller.tick(time_s, base_position, base_quaternion, base_velocity, base_angular_velocity, joint_pos)

World x forward, z up; SI units; quaternions w x y z; what was not measured is NaN.
"""

import itertools
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

ROUNDING_S = 1e-6
VIOLATION = 1e-9  # Violation of a constraint, in the norm of the Hessian, that counts as none
DEPENDENT = 1e-18
LARGEST_ITERATIONS = 500


@dataclass(frozen=True)
class JointCommand:
    """Feed-forward torque, N·m, joint PD until the next tick, and the ground force that the torque stands for, N."""

    torque: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    planned_force: np.ndarray


class Controller:
    """Follows the plan while its goal is shifted, tick by tick; ``counts`` what was out of the ordinary, by reason."""

    def __init__(self, folder: str | Path) -> None:
        self.t = dict(np.load(Path(folder) / "tables.npz"))
        described = json.loads((Path(folder) / "controller.json").read_text(encoding="utf-8"))
        shapes = {name: one["shape"] or [1] for name, one in described["tables"].items()}
        wrong = [name for name, shape in shapes.items() if list(self.t[name].shape or [1]) != shape]
        if wrong:
            raise ValueError(f"{folder}: tables.npz has {', '.join(wrong)} of other shapes than controller.json says")
        self.n = described["numbers"]
        self.counts = {"time_not_usable": 0, "not_finite": 0, "not_solved": 0, "limited": 0}
        self.shift = np.zeros((self.n["UPDATES"], 3))
        self.target, self.pitch = self.t["target"], self.n["STANCE_PITCH_RAD"]
        self._aim(self.t["planned_goal"])
        self._stance_known = self.n["MEASURED_UNTIL_S"] == 0
        self._stood: list[tuple[float, float]] = []
        self._change, self._changed_s, self._level = np.zeros(4), 0.0, 0.0
        self._updates, self._latest = 0, np.zeros((0, 10))
        self._watched, self._age = -1, 0  # last update, and updates since something sudden, from 1 on
        self._calm: np.ndarray | None = None  # deviation at the last update, without what was sudden
        self._recent: list[float] = []
        self._since = np.zeros(10)
        self._used_s: float | None = None
        self._seen_s: float | None = None
        self._start_s: float | None = None
        self._offset_s, self._since_used = 0.0, 0
        self._origin, self._forward, self._framed = np.zeros(3), np.array([1.0, 0.0, 0.0]), False
        self._last: JointCommand | None = None

    def tick(
        self,
        time_s: float,
        base_position: np.ndarray,
        base_quaternion: np.ndarray,
        base_velocity: np.ndarray,
        base_angular_velocity: np.ndarray,
        joint_pos: np.ndarray,
    ) -> JointCommand:
        """The command for one tick."""
        now_s = self._usable_time(time_s)
        if now_s is None:
            return self._safe_command()
        t = self.t
        measured = [
            np.where(np.abs(values) <= largest, values, np.nan)
            for values, largest in (
                (base_position, t["largest_position"]),
                (base_velocity, t["largest_velocity"]),
                (base_angular_velocity, t["largest_angular_velocity"]),
                (joint_pos, t["largest_joint_pos"]),
            )
        ]
        low, high = t["quaternion_norms"]
        turned = base_quaternion if low <= np.linalg.norm(base_quaternion) <= high else np.full(4, np.nan)
        self._last = self._track(now_s, turned, *measured)
        return self._last

    def _usable_time(self, time_s: float) -> float | None:
        n, seen_s = self.n, self._seen_s
        self._seen_s = time_s if np.isfinite(time_s) else None
        self._since_used += 1
        if not np.isfinite(time_s) or abs(time_s) > n["LARGEST_TIME_S"]:
            return None

        def follows(late_s: float, early_s: float) -> bool:
            return 0 <= late_s - early_s <= n["LONGEST_GAP_S"]

        if self._used_s is not None and not follows(time_s + self._offset_s, self._used_s):
            if seen_s is None or time_s == seen_s or not follows(time_s, seen_s):
                return None
            self._offset_s = self._used_s + self._since_used * (time_s - seen_s) - time_s
        self._used_s, self._since_used = time_s + self._offset_s, 0
        return self._used_s if self._offset_s else time_s

    def _aim(self, goal: np.ndarray) -> None:
        """Take a goal, with what shifts do on the way to it: linear between the tabled distances."""
        shares = [np.interp(goal[0], self.t["authority_x"], one) for one in np.eye(self.n["KNOTS"])]
        self.goal, self.authority = goal, np.einsum("g,gtij->tij", shares, self.t["authority"])

    def _safe_command(self) -> JointCommand:
        self.counts["time_not_usable"] += 1
        if self._last is not None and self._since_used <= self.n["HOLD_TICKS"]:
            return self._last
        zero = np.zeros(self.n["JOINTS"])
        pose = zero if self._last is None else self._last.position
        return JointCommand(zero, pose, zero, zero + self.n["SAFE_KP"], zero + self.n["SAFE_KD"], np.zeros(4))

    def _track(
        self,
        now_s: float,
        quaternion: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        turning: np.ndarray,
        joint_pos: np.ndarray,
    ) -> JointCommand:
        n = self.n
        self._start_s = now_s if self._start_s is None else self._start_s
        if not self._framed and np.isfinite([*position, *quaternion]).all():
            w, x, y, z = quaternion
            yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
            self._forward, self._framed = np.array([np.cos(yaw), np.sin(yaw), 0.0]), True
            self._origin = np.array([position[0], position[1], 0.0])
        time_s = now_s - self._start_s
        if not self._stance_known:
            self._measure_stance(time_s, quaternion, position, joint_pos)
        update = int(np.clip((time_s + ROUNDING_S) / n["UPDATE_S"], 0, n["UPDATES"] - 1))
        before = self.shift[update - 1].copy() if update else np.zeros(3)
        share = min((time_s - update * n["UPDATE_S"]) / n["UPDATE_S"], 1.0)
        gone = min(max((time_s - self._changed_s) / n["REACHED_IN_S"], 0.0), 1.0)  # of the way to the stance
        moved = gone * self._change + np.append(before + share * (self.shift[update] - before), 0.0)
        if time_s <= n["TAKE_OFF_S"]:
            w, x, y, z = quaternion
            pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
            ahead = (position - self._origin) @ self._forward
            trunk = [ahead, position[2] - self._level, pitch, velocity @ self._forward, velocity[2], turning[1]]
            at = slice(n["OF_STATE"], n["OF_STATE"] + 10)
            feet = self._feet(quaternion, joint_pos)
            feet = np.column_stack([feet @ self._forward, feet[:, 2]])
            deviation = np.append(trunk, feet) - self._planned(time_s, moved)[at]
            self._latest = np.concatenate([self._latest, deviation[None]])[-n["KEPT"] :]
        if update >= self._updates:
            self._updates = update + 1
            self.shift[update:] = before + self._chosen(update, before)
        rate = np.append((self.shift[update] - before) / n["UPDATE_S"] * (share < 1), 0.0)
        return self._follow(time_s, moved, rate + (gone < 1) / n["REACHED_IN_S"] * self._change)

    def _measure_stance(
        self, time_s: float, quaternion: np.ndarray, position: np.ndarray, joint_pos: np.ndarray
    ) -> None:
        """Take in the stance while all feet stand; at the end choose goal and target for it."""
        t = self.t
        if time_s < self.n["MEASURED_UNTIL_S"] - ROUNDING_S:
            if np.isfinite([*position, *quaternion, *joint_pos]).all():
                front, rear = self._feet(quaternion, joint_pos)
                apart = front - rear
                self._stood.append((-np.arctan2(apart[2], np.hypot(apart[0], apart[1])), position[2]))
            return
        self._stance_known = True
        if not self._stood:
            return
        pitch, height = np.mean(self._stood, axis=0)
        if not t["stance_pitch"][0] <= pitch <= t["stance_pitch"][-1]:
            return
        goal = np.array([np.interp(pitch, t["stance_pitch"], column) for column in t["stance_goal"].T])
        self._change, self._changed_s = np.append(goal - self.goal, pitch - self.pitch), time_s
        self.pitch = float(pitch)
        self._aim(goal)
        self.target = self._landing(goal)
        self._level = height - self._planned(0.0, self._change)[self.n["OF_STATE"] + 1]

    def _row(self, time_s: float) -> int:
        return min(max(round(time_s / self.n["ROW_S"]), 0), self.n["ROWS"] - 1)

    def _planned(self, time_s: float, moved: np.ndarray) -> np.ndarray:
        """The row of the plan at this time, where goal and stance are moved."""
        row = self.t["plan"][self._row(time_s)]
        return row[0] + moved[: self.n["AXES"]] @ row[1:]

    def _follow(self, time_s: float, moved: np.ndarray, rate: np.ndarray) -> JointCommand:
        n, row, planned = self.n, self.t["plan"][self._row(time_s)], self._planned(time_s, moved)
        joints, moving = n["JOINTS"], time_s <= n["LANDING_S"]
        position, velocity, torque = (
            slice(n[f"OF_{part}"], n[f"OF_{part}"] + joints) for part in ("POSITION", "VELOCITY", "TORQUE")
        )
        force = slice(n["OF_FORCE"], n["OF_FORCE"] + 4)
        kp, kd = self.t["gains"][self.t["gains_of_row"][self._row(time_s)]]
        return self._within_motors(
            JointCommand(
                torque=np.clip(planned[torque], -n["TORQUE_NM"], n["TORQUE_NM"]) * moving,
                position=planned[position],
                velocity=(planned[velocity] + rate[: n["AXES"]] @ row[1:, position]) * moving,
                kp=kp,
                kd=kd,
                planned_force=planned[force] * (row[0, force] != 0) * moving,
            )
        )

    def _within_motors(self, command: JointCommand) -> JointCommand:
        """The command, with torques and force of each pair shrunk to what the motors can do."""
        limit, pairs = self.t["torque_limit"], self.t["pair_of_joint"]
        share = np.ones(2)
        for pair in range(2):
            own = pairs == pair
            largest = (np.abs(command.torque[own]) / limit[own]).max(initial=0.0)
            share[pair] = min(1.0, 1.0 / largest) if largest > 0 else 1.0
        if (share == 1.0).all():
            return command
        self.counts["limited"] += 1
        scaled = np.clip(command.torque * np.where(pairs < 0, 1.0, share[pairs]), -limit, limit)
        return replace(command, torque=scaled, planned_force=command.planned_force * np.repeat(share, 2))

    def _feet(self, quaternion: np.ndarray, joint_pos: np.ndarray) -> np.ndarray:
        """Mean foot − base of each pair, front and rear, in world axes, (2, 3)."""
        t, feet = self.t, np.zeros((2, 3))
        for foot in range(self.n["FEET"]):
            turned, at = matrix(quaternion), np.zeros(3)
            for link in range(*t["links_of_foot"][foot : foot + 2]):
                at = at + turned @ t["link_position"][link]
                turned = turned @ t["link_rotation"][link].reshape(3, 3)
                joint, anchor = t["link_joint"][link], t["link_anchor"][link]
                if joint >= 0:
                    half = (joint_pos[joint] - t["link_zero"][link]) / 2
                    at = at + turned @ anchor
                    turned = turned @ matrix(np.append(np.cos(half), np.sin(half) * t["link_axis"][link]))
                    at = at - turned @ anchor
            feet += np.outer(t["foot_share"][foot], at + turned @ t["foot_point"][foot])
        return feet

    def _landing(self, goal: np.ndarray) -> np.ndarray:
        """Landing of a jump to one constant goal in which nothing unexpected happens."""
        t, at = self.t, np.append(goal, self.pitch)
        apart = at / t["landing_scale"] - t["landing_sample"]
        kernel = np.exp(-(apart**2).sum(axis=1) / 2)
        found: np.ndarray = goal + np.append(1.0, at) @ t["landing_trend"] + kernel @ t["landing_dual"]
        return found

    def _chosen(self, update: int, before: np.ndarray) -> np.ndarray:
        """Change of the shift at an update; zero until something sudden has happened, or where it has no solution."""
        if not self._stance_known:
            return np.zeros(3)
        deviation = self._latest.mean(axis=0) if len(self._latest) else np.full(10, np.nan)
        since = self._since_change(update, deviation)
        if not np.isfinite(deviation).all():
            self.counts["not_finite"] += 1
        if since is None or update >= self.n["FREE_UPDATES"]:
            return np.zeros(3)
        held = np.concatenate([self.shift[:update], np.tile(before, (len(self.shift) - update, 1))])
        landing = self._landing(self.goal) + since @ self.t["by_change"][update, int(self._age > 1)]
        found = self._solve(update, landing + np.einsum("tij,tj->i", self.authority, held), before)
        if found is None:
            self.counts["not_solved"] += 1
            return np.zeros(3)
        return found[:3]

    def _since_change(self, update: int, deviation: np.ndarray) -> np.ndarray | None:
        """What a sudden change has added to the deviation now and before; None without it, and where not finite."""
        gap, self._watched = update - self._watched, update
        finite = bool(np.isfinite(deviation).all())
        if self._calm is None:
            self._calm = deviation if finite else None
            return None
        carry, calm = self.t["carry"], self._calm
        for passed in range(update - gap + 1, update + 1):
            calm = carry[passed, 0] + calm @ carry[passed, 1:]
        if self._age:
            self._age += gap
        elif finite and gap == 1 and self._is_sudden(update, deviation - calm):
            self._age = 1
        elif finite:
            calm = deviation
        self._calm = calm
        if not (self._age and finite):
            return None
        before, self._since = self._since, deviation - calm
        return np.concatenate([self._since, before])

    def _is_sudden(self, update: int, left: np.ndarray) -> bool:
        """Whether what is unexpected of a deviation surprises more than at the recent updates but the last."""
        n, surprise = self.n, float(left @ self.t["precision"][update] @ left) / len(left)
        usual = max(1.0, *self._recent[:-1]) if len(self._recent) == n["RECENT"] else np.inf
        self._recent = [*self._recent, surprise][-n["RECENT"] :]
        return surprise > n["LEAST_SURPRISE"] and surprise > n["TIMES_RECENT"] * usual

    def _solve(self, update: int, landing: np.ndarray, before: np.ndarray) -> np.ndarray | None:
        """Shifts of all steps and slacks of this update's quadratic program; None where it has no solution."""
        t, n = self.t, self.n
        steps = int(t["steps_of_update"][update])
        shifts, size = 3 * steps, 3 * steps + 3
        miss, weight = landing - self.target, 1 / t["matters_of_target"] ** 2
        effect, uncertain = self._effects(update)
        gradient = np.append(effect.T @ (weight * miss), np.zeros(3))
        hessian = t["hessian"][update, :size, :size].copy()
        hessian[:shifts, :shifts] += effect.T @ (weight[:, None] * effect) + uncertain
        upper = np.append(np.tile(t["largest_shift"] - before, steps), np.full(3, np.inf))
        lower = np.append(np.tile(-t["largest_shift"] - before, steps), np.zeros(3))
        upper[:3] = np.minimum(upper[:3], t["largest_change"])
        lower[:3] = np.maximum(lower[:3], -t["largest_change"])
        scale = t["bound_scale"][update, :size]
        of_landing = np.zeros((3, size))
        of_landing[:, :shifts] = effect[2], -effect[2], -effect[1]
        of_landing[[0, 1, 2], [shifts, shifts, shifts + 1]] = -t["landing_soft"]
        of_landing *= t["landing_row_scale"][update][:, None]
        limits = np.array([n["LARGEST_PITCH_RAD"] - landing[2], n["LARGEST_PITCH_RAD"] + landing[2]])
        limits = np.append(limits, n["BELOW_TARGET_M"] + miss[1]) * t["landing_row_scale"][update]
        efforts, room = self._efforts(update, before, size)
        rows = np.concatenate([np.diag(scale), -np.diag(scale), of_landing, efforts])
        bounds = np.concatenate([upper * scale, -lower * scale, limits, room])
        return solve(np.linalg.inv(np.linalg.cholesky(hessian)).T, gradient, rows, bounds)

    def _effects(self, update: int) -> tuple[np.ndarray, np.ndarray]:
        """Change of the landing by the shift of each step, (3, 3 steps), and the cost of what is uncertain of it."""
        t, n = self.t, self.n
        edges = t["edges_of_update"][update, : t["steps_of_update"][update] + 1]
        later = np.gradient(self.authority, axis=0)
        effect, timing = (
            np.concatenate([of_update[a:b].sum(axis=0) for a, b in itertools.pairwise(edges)], axis=1)
            for of_update in (self.authority, later)
        )
        matters = t["matters_of_target"][:, None]
        ways = np.concatenate([n["AUTHORITY_DOUBT"] * effect / matters, n["TIMING_DOUBT"] * timing / matters])
        axis = np.arange(ways.shape[1]) % 3
        return effect * (update < n["FREE_UPDATES"]), ways.T @ ways * (axis[:, None] == axis)

    def _efforts(self, update: int, before: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
        """Limits of forces and torques: rows (m, size), and distances (m,)."""
        t, axes = self.t, self.n["AXES"]
        own = slice(*t["efforts_of_update"][update : update + 2])
        slopes, at = t["effort_slope"][own], t["effort_step"][own]
        rows = np.zeros((len(at), size))
        for axis in range(3):
            rows[np.arange(len(at)), 3 * at + axis] = slopes[:, axis]
        rows[:, -1] = -t["effort_soft"][own]
        moved = (np.append(before, 0.0) + self._change)[:axes]
        return rows, np.maximum(t["effort_room"][own] - slopes @ moved, 0.0)


def matrix(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) of a quaternion w x y z of any length."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def solve(root: np.ndarray, gradient: np.ndarray, rows: np.ndarray, bounds: np.ndarray) -> np.ndarray | None:
    """min ½ xᵀ H x + gradientᵀ x with rows x ≤ bounds, where root rootᵀ = H⁻¹; None where there is no solution.

    Dual active-set method of Goldfarb and Idnani (1983): from the minimum without constraints, the one violated most is
    enforced at a time, and others are released where their multipliers would change sign.
    """
    x = -root @ (root.T @ gradient)
    active: list[int] = []
    multipliers = np.zeros(0)
    iterations = 0
    while True:
        slack = bounds - rows @ x
        slack[active] = np.inf
        worst = int(np.argmin(slack))
        if slack[worst] >= -VIOLATION:
            return x
        direction, added, left = -root.T @ rows[worst], 0.0, float(slack[worst])
        while True:
            iterations += 1
            if iterations > LARGEST_ITERATIONS:
                return None
            held = -root.T @ rows[active].T
            q, r = np.linalg.qr(held)
            by_active = np.linalg.solve(r, q.T @ direction)
            free = direction - held @ by_active
            along = float(free @ free)
            ratios = np.where(by_active > 0, multipliers / np.where(by_active > 0, by_active, 1.0), np.inf)
            largest = ratios.min(initial=np.inf)
            full = -left / along if along > DEPENDENT * float(direction @ direction) else np.inf
            step = min(full, largest)
            if not np.isfinite(step):
                return None
            multipliers, added = multipliers - step * by_active, added + step
            if np.isfinite(full):
                x = x + step * root @ free
                left += step * along
            if step == full:
                active, multipliers = [*active, worst], np.append(multipliers, added)
                break
            leaves = int(np.argmin(ratios))
            active, multipliers = active[:leaves] + active[leaves + 1 :], np.delete(multipliers, leaves)
