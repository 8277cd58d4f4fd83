/* See jump_body.h. */
#include "jump_body.h"

#include <math.h>
#include <string.h>

#include "tables.h"

JumpBody jump_body;

void jump_body_reset(void) {
    memset(&jump_body, 0, sizeof jump_body);
    jump_body.seen_s = NAN;
}

const JumpCounts *jump_counts(void) { return &jump_body.counts; }

int jump_are_finite(const double *values, int count) {
    int finite = 1;
    for (int i = 0; i < count; i++) finite = finite && isfinite(values[i]);
    return finite;
}

static int follows(double time_s, double before_s) {
    return time_s - before_s >= 0 && time_s - before_s <= LONGEST_GAP_S;
}

static void keep_possible(double *values, int count, double largest) {
    for (int i = 0; i < count; i++)
        if (!(fabs(values[i]) <= largest)) values[i] = NAN;
}

/* Whether the time of an estimate can be used; then the estimate without values that no robot can have. */
static int judge(JumpEstimate *e) {
    double seen_s = jump_body.seen_s;
    jump_body.seen_s = isfinite(e->time_s) ? e->time_s : NAN;
    jump_body.ticks_since_used++;
    if (!isfinite(e->time_s) || fabs(e->time_s) > LARGEST_TIME_S) return 0;
    if (jump_body.has_used && !follows(e->time_s + jump_body.offset_s, jump_body.used_s)) {
        if (isnan(seen_s) || e->time_s == seen_s || !follows(e->time_s, seen_s)) return 0;
        jump_body.offset_s = jump_body.used_s + jump_body.ticks_since_used * (e->time_s - seen_s) - e->time_s;
    }
    jump_body.used_s = e->time_s + jump_body.offset_s;
    jump_body.has_used = 1;
    jump_body.ticks_since_used = 0;
    if (jump_body.offset_s != 0) e->time_s = jump_body.used_s;
    keep_possible(e->base_position, 3, largest_position);
    keep_possible(e->base_velocity, 3, largest_velocity);
    keep_possible(e->base_angular_velocity, 3, largest_angular_velocity);
    keep_possible(e->joint_pos, JOINTS, largest_joint_pos);
    const double *q = e->base_quaternion;
    double norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(norm >= quaternion_norms[0] && norm <= quaternion_norms[1]))
        for (int i = 0; i < 4; i++) e->base_quaternion[i] = NAN;
    return 1;
}

static void start(const JumpEstimate *e) {
    if (!jump_body.started) {
        jump_body.start_s = e->time_s;
        jump_body.started = 1;
        jump_body.forward[0] = 1;
    }
    if (jump_body.framed) return;
    if (!jump_are_finite(e->base_position, 3) || !jump_are_finite(e->base_quaternion, 4)) return;
    const double *q = e->base_quaternion;
    const double yaw = atan2(2 * (q[0] * q[3] + q[1] * q[2]), 1 - 2 * (q[2] * q[2] + q[3] * q[3]));
    jump_body.x = e->base_position[0];
    jump_body.y = e->base_position[1];
    jump_body.forward[0] = cos(yaw);
    jump_body.forward[1] = sin(yaw);
    jump_body.framed = 1;
}

static void safe_command(JumpCommand *command) {
    const JumpCommand last = jump_body.last;
    jump_body.counts.time_not_usable++;
    if (jump_body.has_last && jump_body.ticks_since_used <= HOLD_TICKS) {
        *command = last;
        return;
    }
    memset(command, 0, sizeof *command);
    for (int j = 0; j < JOINTS; j++) {
        command->position[j] = last.position[j];
        command->kp[j] = SAFE_KP;
        command->kd[j] = SAFE_KD;
    }
}

int jump_body_begin(JumpEstimate *e, JumpCommand *command) {
    if (!judge(e)) {
        safe_command(command);
        return 0;
    }
    start(e);
    return 1;
}

/* Shrink torques and force of each pair to what the motors can do. */
static void limit(JumpCommand *command) {
    double share[2] = {1, 1};
    for (int j = 0; j < JOINTS; j++) {
        if (pair_of_joint[j] < 0) continue;
        const double within = torque_limit[j] / fabs(command->torque[j]);
        if (within < share[pair_of_joint[j]]) share[pair_of_joint[j]] = within;
    }
    if (share[0] == 1 && share[1] == 1) return;
    jump_body.counts.limited++;
    for (int j = 0; j < JOINTS; j++)
        if (pair_of_joint[j] >= 0)
            command->torque[j] = fmax(-torque_limit[j], fmin(torque_limit[j], command->torque[j] * share[pair_of_joint[j]]));
    for (int i = 0; i < 4; i++) command->planned_force[i] *= share[i / 2];
}

void jump_body_end(JumpCommand *command) {
    limit(command);
    jump_body.last = *command;
    jump_body.has_last = 1;
}

/* Rotation matrix of a quaternion of any length, row by row. */
static void to_matrix(const double *q, double m[9]) {
    const double s = 2 / (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    const double rows[9] = {1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y),
                            s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x),
                            s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)};
    memcpy(m, rows, sizeof rows);
}

static void multiply(double a[9], const double b[9]) {
    double c[9];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) c[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
    memcpy(a, c, sizeof c);
}

static void add_turned(double to[3], const double m[9], const double v[3], double sign) {
    for (int i = 0; i < 3; i++) to[i] += sign * (m[3 * i] * v[0] + m[3 * i + 1] * v[1] + m[3 * i + 2] * v[2]);
}

/* Joint torques -J'u of the joints of one leg, by the places and axes of its links in world axes. */
static void add_torques(int foot, const double at[3], double anchor[LINKS][3], double axis[LINKS][3],
                        const double (*force)[3], double *torque) {
    double f[3];
    for (int i = 0; i < 3; i++) f[i] = foot_share[foot][0] * force[0][i] + foot_share[foot][1] * force[1][i];
    for (int link = links_of_foot[foot]; link < links_of_foot[foot + 1]; link++) {
        if (link_joint[link] < 0) continue;
        const double *a = axis[link], *p = anchor[link], r[3] = {at[0] - p[0], at[1] - p[1], at[2] - p[2]};
        torque[link_joint[link]] -= a[0] * (r[1] * f[2] - r[2] * f[1]) + a[1] * (r[2] * f[0] - r[0] * f[2]) +
                                    a[2] * (r[0] * f[1] - r[1] * f[0]);
    }
}

void jump_legs(const double quaternion[4], const double joint_pos[JOINTS], double feet[2][3], const double (*force)[3],
               double *torque) {
    double base[9], anchor[LINKS][3], axis[LINKS][3];
    to_matrix(quaternion, base);
    memset(feet, 0, 6 * sizeof **feet);
    if (force) memset(torque, 0, JOINTS * sizeof *torque);
    for (int foot = 0; foot < FEET; foot++) {
        double m[9], at[3] = {0, 0, 0};
        memcpy(m, base, sizeof m);
        for (int link = links_of_foot[foot]; link < links_of_foot[foot + 1]; link++) {
            add_turned(at, m, link_position[link], 1);
            multiply(m, link_rotation[link]);
            int joint = link_joint[link];
            if (joint < 0) continue;
            double half = (joint_pos[joint] - link_zero[link]) / 2, turn[9], q[4];
            q[0] = cos(half);
            for (int i = 0; i < 3; i++) q[1 + i] = sin(half) * link_axis[link][i];
            to_matrix(q, turn);
            add_turned(at, m, link_anchor[link], 1);
            memcpy(anchor[link], at, sizeof at);
            memset(axis[link], 0, sizeof axis[link]);
            add_turned(axis[link], m, link_axis[link], 1);
            multiply(m, turn);
            add_turned(at, m, link_anchor[link], -1);
        }
        add_turned(at, m, foot_point[foot], 1);
        for (int pair = 0; pair < 2; pair++)
            for (int i = 0; i < 3; i++) feet[pair][i] += foot_share[foot][pair] * at[i];
        if (force) add_torques(foot, at, anchor, axis, force, torque);
    }
}

int jump_row_at(double time_s) {
    double row = nearbyint(time_s / ROW_S);
    return row < 0 ? 0 : row > ROWS - 1 ? ROWS - 1 : (int)row;
}

void jump_planar(const JumpEstimate *e, double planar[10]) {
    const double *p = e->base_position, *q = e->base_quaternion, *v = e->base_velocity, *ahead = jump_body.forward;
    double feet[2][3];
    const double sine = 2 * (q[0] * q[2] - q[3] * q[1]);
    planar[0] = (p[0] - jump_body.x) * ahead[0] + (p[1] - jump_body.y) * ahead[1];
    planar[1] = p[2] - jump_body.level;
    planar[2] = asin(sine > 1 ? 1 : sine < -1 ? -1 : sine);
    planar[3] = v[0] * ahead[0] + v[1] * ahead[1];
    planar[4] = v[2];
    planar[5] = e->base_angular_velocity[1];
    jump_legs(e->base_quaternion, e->joint_pos, feet, 0, 0);
    for (int pair = 0; pair < 2; pair++) {
        planar[6 + 2 * pair] = feet[pair][0] * ahead[0] + feet[pair][1] * ahead[1];
        planar[7 + 2 * pair] = feet[pair][2];
    }
}
