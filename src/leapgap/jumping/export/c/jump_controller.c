/* See jump_controller.h. The numbers of this jump are in sizes.h and tables.c; controller.py is the same in NumPy. */
#include "jump_controller.h"

#include <math.h>
#include <string.h>

#include "jump_program.h"
#include "tables.h"

#define STATE 6                                     /* x z pitch and their rates */
#define DEVIATIONS (STATE + 4)                      /* trunk, then feet: front x z, rear x z */
#define ROUNDING_S 1e-6

static struct {
    int started, framed, has_used, has_last, ticks_since_used, updates, kept, next;
    double used_s, seen_s, offset_s, start_s;
    double x, y, level, forward[2]; /* frame of the start: position, height of the plan's zero, heading */
    int stance_known, stood;
    double pitch_sum, height_sum;     /* of the ground and of the base over the ticks that stood */
    double goal[3], target[3], pitch; /* where the jump goes, where it shall land, and the stance it begins in */
    JumpAuthority authority;          /* for this goal */
    double change[4], changed_s;      /* of goal and stance from those of the plan, and since when */
    double shift[UPDATES][3];
    double latest[KEPT][DEVIATIONS];
    int watched, has_calm, age;       /* last update, and updates since something sudden, from 1 on */
    double calm[DEVIATIONS];          /* deviation at the last update, without what was sudden */
    double since[DEVIATIONS];         /* what a sudden change had added at the last update */
    double recent[RECENT];            /* surprises of the last updates */
    int surprises;
    JumpCommand last;
    JumpCounts counts;
} now;

/* Place of x among rising values: the last one at or below it, and the share of the way to the next, 0 to 1. */
static int place(const double *at, int count, double x, double *share) {
    int k = 0;
    while (k + 2 < count && x >= at[k + 1]) k++;
    *share = count > 1 ? fmin(fmax((x - at[k]) / (at[k + 1] - at[k]), 0), 1) : 0;
    return k;
}

/* Take a goal, with what shifts do on the way to it: linear between the tabled distances. */
static void aim(const double goal[3]) {
    double share;
    const int k = place(authority_x, KNOTS, goal[0], &share), next = k + (KNOTS > 1);
    memcpy(now.goal, goal, sizeof now.goal);
    for (int t = 0; t < UPDATES; t++)
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                now.authority.by_update[t][i][j] = (1 - share) * authority[k][t][i][j] + share * authority[next][t][i][j];
}

void jump_reset(void) {
    memset(&now, 0, sizeof now);
    now.seen_s = NAN;
    now.watched = -1;
    now.stance_known = MEASURED_UNTIL_S == 0;
    now.pitch = STANCE_PITCH_RAD;
    aim(planned_goal);
    memcpy(now.target, target, sizeof now.target);
}

const JumpCounts *jump_counts(void) { return &now.counts; }

const double *jump_shift(void) { return now.shift[now.updates ? now.updates - 1 : 0]; }

/* ---- what is measured ---- */

static int follows(double time_s, double before_s) {
    return time_s - before_s >= 0 && time_s - before_s <= LONGEST_GAP_S;
}

static void keep_possible(double *values, int count, double largest) {
    for (int i = 0; i < count; i++)
        if (!(fabs(values[i]) <= largest)) values[i] = NAN;
}

/* Whether the time of an estimate can be used; then the estimate without values that no robot can have. */
static int judge(JumpEstimate *e) {
    double seen_s = now.seen_s;
    now.seen_s = isfinite(e->time_s) ? e->time_s : NAN;
    now.ticks_since_used++;
    if (!isfinite(e->time_s) || fabs(e->time_s) > LARGEST_TIME_S) return 0;
    if (now.has_used && !follows(e->time_s + now.offset_s, now.used_s)) {
        if (isnan(seen_s) || e->time_s == seen_s || !follows(e->time_s, seen_s)) return 0;
        now.offset_s = now.used_s + now.ticks_since_used * (e->time_s - seen_s) - e->time_s;
    }
    now.used_s = e->time_s + now.offset_s;
    now.has_used = 1;
    now.ticks_since_used = 0;
    if (now.offset_s != 0) e->time_s = now.used_s;
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

/* Mean foot - base of each pair, front and rear, in world axes. */
static void pair_offsets(const JumpEstimate *e, double feet[2][3]) {
    double base[9];
    to_matrix(e->base_quaternion, base);
    memset(feet, 0, 6 * sizeof **feet);
    for (int foot = 0; foot < FEET; foot++) {
        double m[9], at[3] = {0, 0, 0};
        memcpy(m, base, sizeof m);
        for (int link = links_of_foot[foot]; link < links_of_foot[foot + 1]; link++) {
            add_turned(at, m, link_position[link], 1);
            multiply(m, link_rotation[link]);
            int joint = link_joint[link];
            if (joint < 0) continue;
            double half = (e->joint_pos[joint] - link_zero[link]) / 2, turn[9], q[4];
            q[0] = cos(half);
            for (int i = 0; i < 3; i++) q[1 + i] = sin(half) * link_axis[link][i];
            to_matrix(q, turn);
            add_turned(at, m, link_anchor[link], 1);
            multiply(m, turn);
            add_turned(at, m, link_anchor[link], -1);
        }
        add_turned(at, m, foot_point[foot], 1);
        for (int pair = 0; pair < 2; pair++)
            for (int i = 0; i < 3; i++) feet[pair][i] += foot_share[foot][pair] * at[i];
    }
}

static int row_at(double time_s) {
    double row = nearbyint(time_s / ROW_S);
    return row < 0 ? 0 : row > ROWS - 1 ? ROWS - 1 : (int)row;
}

/* Entries first ... first + count - 1 of a row of the plan, where goal and stance are moved. */
static void plan_at(int row, int first, int count, const double moved[4], double *values) {
    for (int i = 0; i < count; i++) {
        values[i] = plan[row][0][first + i];
        for (int axis = 0; axis < AXES; axis++) values[i] += moved[axis] * plan[row][1 + axis][first + i];
    }
}

/* Keep how far trunk and feet are from the shifted plan. */
static void measure(double time_s, const JumpEstimate *e, const double moved[4]) {
    const double *p = e->base_position, *q = e->base_quaternion, *v = e->base_velocity;
    double deviation[DEVIATIONS], planned[DEVIATIONS], feet[2][3];
    double sine = 2 * (q[0] * q[2] - q[3] * q[1]);
    deviation[0] = (p[0] - now.x) * now.forward[0] + (p[1] - now.y) * now.forward[1];
    deviation[1] = p[2] - now.level;
    deviation[2] = asin(sine > 1 ? 1 : sine < -1 ? -1 : sine);
    deviation[3] = v[0] * now.forward[0] + v[1] * now.forward[1];
    deviation[4] = v[2];
    deviation[5] = e->base_angular_velocity[1];
    pair_offsets(e, feet);
    for (int pair = 0; pair < 2; pair++) {
        deviation[STATE + 2 * pair] = feet[pair][0] * now.forward[0] + feet[pair][1] * now.forward[1];
        deviation[STATE + 2 * pair + 1] = feet[pair][2];
    }
    plan_at(row_at(time_s), OF_STATE, DEVIATIONS, moved, planned);
    for (int i = 0; i < DEVIATIONS; i++) now.latest[now.next][i] = deviation[i] - planned[i];
    now.next = (now.next + 1) % KEPT;
    if (now.kept < KEPT) now.kept++;
}

/* Mean of what was kept; whether it is finite. */
static int mean_deviation(double mean[DEVIATIONS]) {
    int finite = now.kept > 0;
    for (int i = 0; i < DEVIATIONS; i++) {
        mean[i] = 0;
        for (int k = 0; k < now.kept; k++) mean[i] += now.latest[k][i];
        mean[i] /= now.kept ? now.kept : 1;
        finite = finite && isfinite(mean[i]);
    }
    return finite;
}

/* ---- model of the landing ---- */

/* Landing of a jump to one constant goal in which nothing unexpected happens. */
static void landing_of(const double goal[3], double landing[3]) {
    double in[4] = {goal[0], goal[1], goal[2], now.pitch};
    for (int i = 0; i < 3; i++) {
        landing[i] = goal[i] + landing_trend[0][i];
        for (int j = 0; j < 4; j++) landing[i] += in[j] * landing_trend[1 + j][i];
    }
    for (int j = 0; j < 4; j++) in[j] /= landing_scale[j];
    for (int s = 0; s < SAMPLES; s++) {
        double squared = 0;
        for (int j = 0; j < 4; j++) squared += (in[j] - landing_sample[s][j]) * (in[j] - landing_sample[s][j]);
        double near = exp(-squared / 2);
        for (int i = 0; i < 3; i++) landing[i] += near * landing_dual[s][i];
    }
}

/* Landing to reckon with: that of the goal, what shifts do to it, and what was sudden. */
static void predict(int update, const double before[3], const double since[2 * DEVIATIONS], double landing[3]) {
    landing_of(now.goal, landing);
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            for (int t = 0; t < update; t++) landing[i] += now.authority.by_update[t][i][j] * now.shift[t][j];
            for (int t = update; t < UPDATES; t++) landing[i] += now.authority.by_update[t][i][j] * before[j];
        }
        for (int k = 0; k < 2 * DEVIATIONS; k++) landing[i] += since[k] * by_change[update][now.age > 1][k][i];
    }
}

/* ---- what is sudden ---- */

/* Whether what is unexpected of a deviation surprises more than at the recent updates but the last. */
static int is_sudden(int update, const double left[DEVIATIONS]) {
    double surprise = 0, usual = 1;
    for (int i = 0; i < DEVIATIONS; i++)
        for (int j = 0; j < DEVIATIONS; j++) surprise += left[i] * precision[update][i][j] * left[j] / DEVIATIONS;
    for (int k = 0; k < RECENT; k++) /* all but the last one */
        if (k != (now.surprises + RECENT - 1) % RECENT) usual = fmax(usual, now.recent[k]);
    now.recent[now.surprises % RECENT] = surprise;
    return now.surprises++ >= RECENT && surprise > LEAST_SURPRISE && surprise > TIMES_RECENT * usual;
}

/* What a sudden change has added to the deviation now and before; whether there was one and the deviation is finite. */
static int since_change(int update, const double deviation[DEVIATIONS], int finite, double since[2 * DEVIATIONS]) {
    const int last = now.watched, gap = update - last;
    now.watched = update;
    if (!now.has_calm) {
        now.has_calm = finite;
        if (finite) memcpy(now.calm, deviation, sizeof now.calm);
        return 0;
    }
    for (int u = last + 1; u <= update; u++) {
        double next[DEVIATIONS];
        for (int i = 0; i < DEVIATIONS; i++) {
            next[i] = carry[u][0][i];
            for (int k = 0; k < DEVIATIONS; k++) next[i] += now.calm[k] * carry[u][1 + k][i];
        }
        memcpy(now.calm, next, sizeof next);
    }
    for (int i = 0; i < DEVIATIONS; i++) since[i] = deviation[i] - now.calm[i];
    if (now.age) now.age += gap;
    else if (finite && gap == 1 && is_sudden(update, since)) now.age = 1;
    else if (finite) memcpy(now.calm, deviation, sizeof now.calm);
    if (!now.age || !finite) return 0;
    memcpy(since + DEVIATIONS, now.since, sizeof now.since);
    memcpy(now.since, since, sizeof now.since);
    return 1;
}

/* ---- stance that was not seen before the jump ---- */

static int are_finite(const double *values, int count) {
    int finite = 1;
    for (int i = 0; i < count; i++) finite = finite && isfinite(values[i]);
    return finite;
}

/* Take in the stance while all feet stand; at the end choose goal and target for it. */
static void measure_stance(double time_s, const JumpEstimate *e) {
    double feet[2][3], goal[3], state[STATE], pitch, share;
    if (time_s < MEASURED_UNTIL_S - ROUNDING_S) {
        if (!are_finite(e->base_position, 3) || !are_finite(e->base_quaternion, 4) || !are_finite(e->joint_pos, JOINTS))
            return;
        pair_offsets(e, feet);
        now.stood++;
        now.pitch_sum -= atan2(feet[0][2] - feet[1][2], hypot(feet[0][0] - feet[1][0], feet[0][1] - feet[1][1]));
        now.height_sum += e->base_position[2];
        return;
    }
    now.stance_known = 1;
    if (!now.stood) return;
    pitch = now.pitch_sum / now.stood;
    if (!(pitch >= stance_pitch[0] && pitch <= stance_pitch[PITCHES - 1])) return;
    const int k = place(stance_pitch, PITCHES, pitch, &share), next = k + (PITCHES > 1);
    for (int i = 0; i < 3; i++) {
        goal[i] = (1 - share) * stance_goal[k][i] + share * stance_goal[next][i];
        now.change[i] = goal[i] - now.goal[i];
    }
    now.change[3] = pitch - now.pitch;
    now.changed_s = time_s;
    now.pitch = pitch;
    aim(goal);
    landing_of(goal, now.target);
    plan_at(0, OF_STATE, STATE, now.change, state);
    now.level = now.height_sum / now.stood - state[1];
}

/* ---- commands ---- */

/* Choose the shift from this update on; it stays until something sudden has happened, or where that is not possible. */
static void choose_shift(int update, const double before[3]) {
    double deviation[DEVIATIONS], since[2 * DEVIATIONS], landing[3], change[3] = {0, 0, 0};
    if (now.stance_known) {
        const int finite = mean_deviation(deviation);
        if (!finite) now.counts.not_finite++;
        if (since_change(update, deviation, finite, since) && update < FREE_UPDATES) {
            predict(update, before, since, landing);
            const JumpProgram program = {update, &now.authority, landing, now.target, before, now.change};
            if (!jump_program_solve(&program, change)) now.counts.not_solved++;
        }
    }
    for (int t = update; t < UPDATES; t++)
        for (int i = 0; i < 3; i++) now.shift[t][i] = before[i] + change[i];
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
    now.counts.limited++;
    for (int j = 0; j < JOINTS; j++)
        if (pair_of_joint[j] >= 0)
            command->torque[j] = fmax(-torque_limit[j], fmin(torque_limit[j], command->torque[j] * share[pair_of_joint[j]]));
    for (int i = 0; i < 4; i++) command->planned_force[i] *= share[i / 2];
}

/* Command of the shifted plan. */
static void follow(double time_s, const double moved[4], const double rate[4], JumpCommand *command) {
    const int row = row_at(time_s), moving = time_s <= LANDING_S;
    const double *unshifted = plan[row][0];
    plan_at(row, OF_POSITION, JOINTS, moved, command->position);
    plan_at(row, OF_VELOCITY, JOINTS, moved, command->velocity);
    plan_at(row, OF_TORQUE, JOINTS, moved, command->torque);
    plan_at(row, OF_FORCE, 4, moved, command->planned_force);
    for (int j = 0; j < JOINTS; j++) {
        for (int i = 0; i < AXES; i++) command->velocity[j] += rate[i] * plan[row][1 + i][OF_POSITION + j];
        command->velocity[j] *= moving;
        command->torque[j] = moving * fmax(-TORQUE_NM, fmin(TORQUE_NM, command->torque[j]));
        command->kp[j] = gains[gains_of_row[row]][0][j];
        command->kd[j] = gains[gains_of_row[row]][1][j];
    }
    for (int i = 0; i < 4; i++) command->planned_force[i] *= moving && unshifted[OF_FORCE + i] != 0;
    limit(command);
}

static void start(const JumpEstimate *e) {
    if (!now.started) {
        now.start_s = e->time_s;
        now.started = 1;
        now.forward[0] = 1;
    }
    if (now.framed) return;
    if (!are_finite(e->base_position, 3) || !are_finite(e->base_quaternion, 4)) return;
    const double *q = e->base_quaternion;
    const double yaw = atan2(2 * (q[0] * q[3] + q[1] * q[2]), 1 - 2 * (q[2] * q[2] + q[3] * q[3]));
    now.x = e->base_position[0];
    now.y = e->base_position[1];
    now.forward[0] = cos(yaw);
    now.forward[1] = sin(yaw);
    now.framed = 1;
}

static void safe_command(JumpCommand *command) {
    const JumpCommand last = now.last;
    now.counts.time_not_usable++;
    if (now.has_last && now.ticks_since_used <= HOLD_TICKS) {
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

void jump_tick(const JumpEstimate *measured, JumpCommand *command) {
    JumpEstimate e = *measured;
    if (!judge(&e)) {
        safe_command(command);
        return;
    }
    start(&e);
    const double time_s = e.time_s - now.start_s, at = (time_s + ROUNDING_S) / UPDATE_S;
    const int update = at < 0 ? 0 : at > UPDATES - 1 ? UPDATES - 1 : (int)at;
    const double share = fmin((time_s - update * UPDATE_S) / UPDATE_S, 1);
    double before[3] = {0, 0, 0}, moved[4], rate[4];
    if (!now.stance_known) measure_stance(time_s, &e);
    if (update) memcpy(before, now.shift[update - 1], sizeof before);
    const double gone = fmin(fmax((time_s - now.changed_s) / REACHED_IN_S, 0), 1); /* of the way to the stance */
    for (int i = 0; i < 4; i++) {
        moved[i] = gone * now.change[i];
        if (i < 3) moved[i] += before[i] + share * (now.shift[update][i] - before[i]);
    }
    if (time_s <= TAKE_OFF_S) measure(time_s, &e, moved);
    if (update >= now.updates) {
        now.updates = update + 1;
        choose_shift(update, before);
    }
    for (int i = 0; i < 4; i++) {
        rate[i] = gone < 1 ? now.change[i] / REACHED_IN_S : 0;
        if (i < 3 && share < 1) rate[i] += (now.shift[update][i] - before[i]) / UPDATE_S;
    }
    follow(time_s, moved, rate, command);
    now.last = *command;
    now.has_last = 1;
}
