/* See jump_controller.h. The numbers of this jump are in sizes.h and tables.c. */
#include <math.h>
#include <string.h>

#include "jump_body.h"
#include "jump_program.h"
#include "tables.h"

#define STATE 6                                     /* x z pitch and their rates */
#define DEVIATIONS (STATE + 4)                      /* trunk, then feet: front x z, rear x z */

static struct {
    int updates, kept, next;
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
    jump_body_reset();
    memset(&now, 0, sizeof now);
    now.watched = -1;
    now.stance_known = MEASURED_UNTIL_S == 0;
    now.pitch = STANCE_PITCH_RAD;
    aim(planned_goal);
    memcpy(now.target, target, sizeof now.target);
}

const double *jump_decided(void) { return now.shift[now.updates ? now.updates - 1 : 0]; }

/* Entries first ... first + count - 1 of a row of the plan, where goal and stance are moved. */
static void plan_at(int row, int first, int count, const double moved[4], double *values) {
    for (int i = 0; i < count; i++) {
        values[i] = plan[row][0][first + i];
        for (int axis = 0; axis < AXES; axis++) values[i] += moved[axis] * plan[row][1 + axis][first + i];
    }
}

/* Keep how far trunk and feet are from the shifted plan. */
static void measure(double time_s, const JumpEstimate *e, const double moved[4]) {
    double deviation[DEVIATIONS], planned[DEVIATIONS];
    jump_planar(e, deviation);
    plan_at(jump_row_at(time_s), OF_STATE, DEVIATIONS, moved, planned);
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

/* Take in the stance while all feet stand; at the end choose goal and target for it. */
static void measure_stance(double time_s, const JumpEstimate *e) {
    double feet[2][3], goal[3], state[STATE], pitch, share;
    if (time_s < MEASURED_UNTIL_S - ROUNDING_S) {
        if (!jump_are_finite(e->base_position, 3) || !jump_are_finite(e->base_quaternion, 4)) return;
        if (!jump_are_finite(e->joint_pos, JOINTS)) return;
        jump_legs(e->base_quaternion, e->joint_pos, feet, 0, 0);
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
    jump_body.level = now.height_sum / now.stood - state[1];
}

/* ---- commands ---- */

/* Choose the shift from this update on; it stays until something sudden has happened, or where that is not possible. */
static void choose_shift(int update, const double before[3]) {
    double deviation[DEVIATIONS], since[2 * DEVIATIONS], landing[3], change[3] = {0, 0, 0};
    if (now.stance_known) {
        const int finite = mean_deviation(deviation);
        if (!finite) jump_body.counts.not_finite++;
        if (since_change(update, deviation, finite, since) && update < FREE_UPDATES) {
            predict(update, before, since, landing);
            const JumpProgram program = {update, &now.authority, landing, now.target, before, now.change};
            if (!jump_program_solve(&program, change)) jump_body.counts.not_solved++;
        }
    }
    for (int t = update; t < UPDATES; t++)
        for (int i = 0; i < 3; i++) now.shift[t][i] = before[i] + change[i];
}

/* Command of the shifted plan. */
static void follow(double time_s, const double moved[4], const double rate[4], JumpCommand *command) {
    const int row = jump_row_at(time_s), moving = time_s <= LANDING_S;
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
}

void jump_tick(const JumpEstimate *measured, JumpCommand *command) {
    JumpEstimate e = *measured;
    if (!jump_body_begin(&e, command)) return;
    const double time_s = e.time_s - jump_body.start_s, at = (time_s + ROUNDING_S) / UPDATE_S;
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
    jump_body_end(command);
}
