/* See jump_controller.h. The numbers of this jump are in tables.h; controller.py is the same in NumPy. */
#include "jump_controller.h"

#include <math.h>
#include <string.h>

#include "tables.h"

#define STATE 6                                     /* x z pitch and their rates */
#define DEVIATIONS (STATE + 4)                      /* trunk, then feet: front x z, rear x z */
#define INPUTS (1 + 3 + 1 + DEVIATIONS)             /* of the landing model: 1, goal, stance, deviation */
#define LANDING_ROWS 3                              /* limits of pitch, upwards and downwards, and of height */
#define CONSTRAINTS (2 * VARIABLES + LANDING_ROWS + LARGEST_EFFORTS)
#define ROUNDING_S 1e-6
#define VIOLATION 1e-9 /* of a constraint, in the norm of the Hessian, that counts as none */
#define DEPENDENT 1e-18
#define LARGEST_ITERATIONS 500

static struct {
    int started, framed, has_used, has_last, ticks_since_used, updates, kept, next;
    double used_s, seen_s, offset_s, start_s;
    double x, y, forward[2]; /* frame of the start: position and heading */
    double shift[UPDATES][3];
    double latest[KEPT][DEVIATIONS];
    JumpCommand last;
    JumpCounts counts;
} now;

/* Quadratic program of one update, min 1/2 x'Hx + g'x, a_i x <= b_i, with a dual active-set method (Goldfarb, Idnani
   1983). inverse_root J: J J' = 1/H. Constraints: upper bounds, lower bounds, landing, efforts. */
static struct {
    int n, update, q;
    double x[VARIABLES], gradient[VARIABLES], lower[VARIABLES], upper[VARIABLES];
    double landing[LANDING_ROWS], room[LARGEST_EFFORTS];
    double J[VARIABLES][VARIABLES], R[VARIABLES][VARIABLES], d[VARIABLES], u[VARIABLES];
    int active[VARIABLES];
    unsigned char is_active[CONSTRAINTS];
} qp;

void jump_reset(void) {
    memset(&now, 0, sizeof now);
    now.seen_s = NAN;
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

/* Mean foot - base of each pair in the frame of the start: front x z, rear x z. */
static void feet_of(const JumpEstimate *e, double feet[4]) {
    double base[9];
    to_matrix(e->base_quaternion, base);
    memset(feet, 0, 4 * sizeof *feet);
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
        double ahead = at[0] * now.forward[0] + at[1] * now.forward[1];
        for (int pair = 0; pair < 2; pair++) {
            feet[2 * pair] += foot_share[foot][pair] * ahead;
            feet[2 * pair + 1] += foot_share[foot][pair] * at[2];
        }
    }
}

static int row_at(double time_s) {
    double row = nearbyint(time_s / ROW_S);
    return row < 0 ? 0 : row > ROWS - 1 ? ROWS - 1 : (int)row;
}

/* Entries first ... first + count - 1 of a row of the plan, moved by a shift of the goal. */
static void plan_at(int row, int first, int count, const double shift[3], double *values) {
    for (int i = 0; i < count; i++) {
        const int j = first + i;
        values[i] = plan[row][0][j] + shift[0] * plan[row][1][j] + shift[1] * plan[row][2][j] + shift[2] * plan[row][3][j];
    }
}

/* Keep how far trunk and feet are from the shifted plan. */
static void measure(double time_s, const JumpEstimate *e, const double shift[3]) {
    const double *p = e->base_position, *q = e->base_quaternion, *v = e->base_velocity;
    double deviation[DEVIATIONS], planned[DEVIATIONS];
    double sine = 2 * (q[0] * q[2] - q[3] * q[1]);
    deviation[0] = (p[0] - now.x) * now.forward[0] + (p[1] - now.y) * now.forward[1];
    deviation[1] = p[2];
    deviation[2] = asin(sine > 1 ? 1 : sine < -1 ? -1 : sine);
    deviation[3] = v[0] * now.forward[0] + v[1] * now.forward[1];
    deviation[4] = v[2];
    deviation[5] = e->base_angular_velocity[1];
    feet_of(e, deviation + STATE);
    plan_at(row_at(time_s), OF_STATE, DEVIATIONS, shift, planned);
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
    double in[4] = {goal[0], goal[1], goal[2], STANCE_PITCH_RAD};
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

/* Landing to reckon with: what was expected before the jump, and the share of what was measured that can be believed. */
static void predict(int update, const double before[3], const double deviation[DEVIATIONS], double landing[3]) {
    double expected[3], predicted[3], goal[3], in[INPUTS], squared = 0, doubt = 0;
    for (int i = 0; i < 3; i++) goal[i] = planned_goal[i] + before[i];
    landing_of(planned_goal, expected);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            for (int t = 0; t < update; t++) expected[i] += authority[t][i][j] * now.shift[t][j];
            for (int t = update; t < UPDATES; t++) expected[i] += authority[t][i][j] * before[j];
        }
    in[0] = 1;
    for (int i = 0; i < 3; i++) in[1 + i] = goal[i];
    in[4] = STANCE_PITCH_RAD;
    for (int i = 0; i < DEVIATIONS; i++) in[5 + i] = deviation[i];
    landing_of(goal, predicted);
    for (int k = 0; k < INPUTS; k++) {
        double sum = 0;
        for (int i = 0; i < 3; i++) predicted[i] += in[k] * feedback[update][k][i];
        for (int l = 0; l < INPUTS; l++) sum += feedback_covariance[update][k][l] * in[l];
        doubt += in[k] * sum;
    }
    for (int i = 0; i < 3; i++) {
        double deviates = matters[i] * sqrt(scatter[update][i] * scatter[update][i] + (doubt > 0 ? doubt : 0));
        squared += (predicted[i] - expected[i]) * (predicted[i] - expected[i]) / (deviates * deviates);
    }
    double doubted = DISBELIEF / (squared > 1e-9 ? squared : 1e-9);
    double share = 1 - doubted * doubted;
    for (int i = 0; i < 3; i++) landing[i] = expected[i] + (share > 0 ? share : 0) * (predicted[i] - expected[i]);
}

/* ---- quadratic program ---- */

static double slack_of(int c) {
    const int n = qp.n, u = qp.update;
    if (c < n) return (qp.upper[c] - qp.x[c]) * bound_scale[u][c];
    if (c < 2 * n) return (qp.x[c - n] - qp.lower[c - n]) * bound_scale[u][c - n];
    c -= 2 * n;
    if (c < LANDING_ROWS) {
        double left = qp.landing[c];
        for (int i = 0; i < n; i++) left -= landing_row[u][c][i] * qp.x[i];
        return left;
    }
    c -= LANDING_ROWS;
    const int e = efforts_of_update[u] + c;
    const double *x = qp.x + 3 * effort_step[e], *slope = effort_slope[e];
    return qp.room[c] - slope[0] * x[0] - slope[1] * x[1] - slope[2] * x[2] + effort_soft[e] * qp.x[n - 1];
}

/* d = -J' a of a constraint. */
static void project(int c) {
    const int n = qp.n, u = qp.update;
    double a[VARIABLES] = {0};
    if (c < n) a[c] = -bound_scale[u][c];
    else if (c < 2 * n) a[c - n] = bound_scale[u][c - n];
    else if (c < 2 * n + LANDING_ROWS)
        for (int i = 0; i < n; i++) a[i] = -landing_row[u][c - 2 * n][i];
    else {
        const int e = efforts_of_update[u] + c - 2 * n - LANDING_ROWS;
        for (int i = 0; i < 3; i++) a[3 * effort_step[e] + i] = -effort_slope[e][i];
        a[n - 1] = effort_soft[e];
    }
    memset(qp.d, 0, sizeof qp.d);
    for (int i = 0; i < n; i++)
        if (a[i] != 0)
            for (int j = 0; j < n; j++) qp.d[j] += a[i] * qp.J[i][j];
}

static void rotate_columns(int j, double c, double s) {
    for (int i = 0; i < qp.n; i++) {
        const double left = qp.J[i][j], right = qp.J[i][j + 1];
        qp.J[i][j] = c * left + s * right;
        qp.J[i][j + 1] = c * right - s * left;
    }
}

static void activate(int c, double multiplier) {
    for (int j = qp.n - 1; j > qp.q; j--) {
        if (qp.d[j] == 0) continue;
        const double r = hypot(qp.d[j - 1], qp.d[j]), cosine = qp.d[j - 1] / r, sine = qp.d[j] / r;
        qp.d[j - 1] = r;
        qp.d[j] = 0;
        rotate_columns(j - 1, cosine, sine);
    }
    for (int i = 0; i <= qp.q; i++) qp.R[i][qp.q] = qp.d[i];
    qp.u[qp.q] = multiplier;
    qp.active[qp.q++] = c;
    qp.is_active[c] = 1;
}

static void release(int l) {
    qp.is_active[qp.active[l]] = 0;
    qp.q--;
    for (int j = l; j < qp.q; j++) {
        qp.active[j] = qp.active[j + 1];
        qp.u[j] = qp.u[j + 1];
        for (int i = 0; i <= j + 1; i++) qp.R[i][j] = qp.R[i][j + 1];
    }
    for (int j = l; j < qp.q; j++) {
        const double r = hypot(qp.R[j][j], qp.R[j + 1][j]);
        if (r == 0) continue;
        const double cosine = qp.R[j][j] / r, sine = qp.R[j + 1][j] / r;
        qp.R[j][j] = r;
        qp.R[j + 1][j] = 0;
        for (int k = j + 1; k < qp.q; k++) {
            const double up = qp.R[j][k], down = qp.R[j + 1][k];
            qp.R[j][k] = cosine * up + sine * down;
            qp.R[j + 1][k] = cosine * down - sine * up;
        }
        rotate_columns(j, cosine, sine);
    }
}

/* Make a violated constraint hold, releasing others where they are in the way; whether that is possible. */
static int enforce(int c, int *iterations) {
    const int n = qp.n;
    double multiplier = 0, slack = slack_of(c);
    while ((*iterations)++ < LARGEST_ITERATIONS) {
        double r[VARIABLES], along = 0, whole = 0, largest = INFINITY;
        int leaves = -1;
        project(c);
        for (int j = 0; j < n; j++) whole += qp.d[j] * qp.d[j];
        for (int j = qp.q; j < n; j++) along += qp.d[j] * qp.d[j];
        for (int i = qp.q - 1; i >= 0; i--) {
            r[i] = qp.d[i];
            for (int k = i + 1; k < qp.q; k++) r[i] -= qp.R[i][k] * r[k];
            r[i] /= qp.R[i][i];
        }
        for (int i = 0; i < qp.q; i++)
            if (r[i] > 0 && qp.u[i] / r[i] < largest) {
                largest = qp.u[i] / r[i];
                leaves = i;
            }
        const double full = along > DEPENDENT * whole ? -slack / along : INFINITY;
        const double step = full < largest ? full : largest;
        if (!isfinite(step)) return 0;
        for (int i = 0; i < qp.q; i++) qp.u[i] -= step * r[i];
        multiplier += step;
        if (isfinite(full)) {
            for (int i = 0; i < n; i++)
                for (int j = qp.q; j < n; j++) qp.x[i] += step * qp.J[i][j] * qp.d[j];
            slack += step * along;
        }
        if (step == full) {
            activate(c, multiplier);
            return 1;
        }
        release(leaves);
    }
    return 0;
}

/* Solve the program; whether it has a solution. */
static int solve(void) {
    const int n = qp.n, u = qp.update;
    const int constraints = 2 * n + LANDING_ROWS + efforts_of_update[u + 1] - efforts_of_update[u];
    double image[VARIABLES] = {0};
    int iterations = 0;
    qp.q = 0;
    memset(qp.is_active, 0, sizeof qp.is_active);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            qp.J[i][j] = inverse_root[u][i][j];
            image[j] -= qp.J[i][j] * qp.gradient[i];
        }
    for (int i = 0; i < n; i++) {
        qp.x[i] = 0;
        for (int j = 0; j < n; j++) qp.x[i] += qp.J[i][j] * image[j];
    }
    for (;;) {
        int worst = -1;
        double least = -VIOLATION;
        for (int c = 0; c < constraints; c++) {
            if (qp.is_active[c]) continue;
            const double slack = slack_of(c);
            if (!(slack >= least)) {
                least = slack;
                worst = c;
            }
        }
        if (worst < 0) return 1;
        if (!enforce(worst, &iterations)) return 0;
    }
}

/* The program of an update from the landing that is predicted without a further change of the shift. */
static void set_problem(int update, const double landing[3], const double before[3]) {
    const int steps = steps_of_update[update], shifts = 3 * steps, n = shifts + 3;
    double miss[3];
    qp.update = update;
    qp.n = n;
    for (int i = 0; i < 3; i++) miss[i] = landing[i] - target[i];
    for (int i = 0; i < n; i++) {
        qp.gradient[i] = 0;
        for (int j = 0; i < shifts && j < 3; j++)
            qp.gradient[i] += authority_of_step[update][j][i] * miss[j] / (matters_of_target[j] * matters_of_target[j]);
        qp.upper[i] = i < shifts ? largest_shift[i % 3] - before[i % 3] : INFINITY;
        qp.lower[i] = i < shifts ? -largest_shift[i % 3] - before[i % 3] : 0;
    }
    for (int i = 0; i < 3; i++) {
        qp.upper[i] = fmin(qp.upper[i], largest_change[i]);
        qp.lower[i] = fmax(qp.lower[i], -largest_change[i]);
    }
    qp.landing[0] = (LARGEST_PITCH_RAD - landing[2]) * landing_row_scale[update][0];
    qp.landing[1] = (LARGEST_PITCH_RAD + landing[2]) * landing_row_scale[update][1];
    qp.landing[2] = (BELOW_TARGET_M + miss[1]) * landing_row_scale[update][2];
    for (int e = efforts_of_update[update]; e < efforts_of_update[update + 1]; e++) {
        const double *slope = effort_slope[e];
        const double room = effort_room[e] - slope[0] * before[0] - slope[1] * before[1] - slope[2] * before[2];
        qp.room[e - efforts_of_update[update]] = room > 0 ? room : 0;
    }
}

/* ---- commands ---- */

/* Choose the shift from this update on; where that is not possible it stays. */
static void choose_shift(int update, const double before[3]) {
    double deviation[DEVIATIONS], landing[3], change[3] = {0, 0, 0};
    if (!mean_deviation(deviation)) now.counts.not_finite++;
    else {
        predict(update, before, deviation, landing);
        set_problem(update, landing, before);
        if (solve()) memcpy(change, qp.x, sizeof change);
        else now.counts.not_solved++;
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
static void follow(double time_s, const double shift[3], const double rate[3], JumpCommand *command) {
    const int row = row_at(time_s), moving = time_s <= LANDING_S;
    const double *unshifted = plan[row][0];
    plan_at(row, OF_POSITION, JOINTS, shift, command->position);
    plan_at(row, OF_VELOCITY, JOINTS, shift, command->velocity);
    plan_at(row, OF_TORQUE, JOINTS, shift, command->torque);
    plan_at(row, OF_FORCE, 4, shift, command->planned_force);
    for (int j = 0; j < JOINTS; j++) {
        for (int i = 0; i < 3; i++) command->velocity[j] += rate[i] * plan[row][1 + i][OF_POSITION + j];
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
    for (int i = 0; i < 3; i++)
        if (!isfinite(e->base_position[i])) return;
    for (int i = 0; i < 4; i++)
        if (!isfinite(e->base_quaternion[i])) return;
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
    double before[3] = {0, 0, 0}, shift[3], rate[3];
    if (update) memcpy(before, now.shift[update - 1], sizeof before);
    for (int i = 0; i < 3; i++) shift[i] = before[i] + share * (now.shift[update][i] - before[i]);
    if (time_s <= TAKE_OFF_S) measure(time_s, &e, shift);
    if (update >= now.updates) {
        now.updates = update + 1;
        choose_shift(update, before);
    }
    for (int i = 0; i < 3; i++) rate[i] = share < 1 ? (now.shift[update][i] - before[i]) / UPDATE_S : 0;
    follow(time_s, shift, rate, command);
    now.last = *command;
    now.has_last = 1;
}
