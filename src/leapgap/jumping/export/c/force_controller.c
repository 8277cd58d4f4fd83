/* See jump_controller.h. Learned MPC of the forces along one plan, in deviations from it. */
#include <math.h>
#include <string.h>

#include "force_program.h"
#include "jump_body.h"
#include "tables.h"

static struct {
    int updates, has_pose, has_good, good;       /* updates so far; the last one that was solved */
    double good_s, forces[STEPS][4];             /* when, and the forces of its steps */
    double decided[4];                           /* for this moment, front x z, rear x z, N */
    int update;                                  /* that decided them */
    double quaternion[4], joint_pos[JOINTS];     /* last that was measured */
} now;

void jump_reset(void) {
    jump_body_reset();
    memset(&now, 0, sizeof now);
}

const double *jump_decided(void) { return now.decided; }

/* Forces of an update without a solution: those of the last one with, while it is valid, else those of the plan. */
static void substitute(int update, double time_s) {
    const int steps = now.has_good ? steps_of_update[now.good] : 0;
    const double *edge = edges_s[now.good];
    memcpy(now.decided, planned_force[update], sizeof now.decided);
    if (now.has_good && time_s - now.good_s <= PLAN_VALID_S + ROUNDING_S && time_s < edge[steps] - ROUNDING_S) {
        int step = 0;
        while (step + 1 < steps && edge[step + 1] <= time_s + ROUNDING_S) step++;
        memcpy(now.decided, now.forces[step], sizeof now.decided);
    }
    for (int i = 0; i < 4; i++) now.decided[i] *= pushes_first[update][i];
}

/* Decide on the forces from this update on. */
static void decide(int update, double time_s, const JumpEstimate *e) {
    double deviation[10], x[VARIABLES];
    jump_planar(e, deviation);
    for (int i = 0; i < 6; i++) deviation[i] -= plan[jump_row_at(time_s)][0][OF_STATE + i];
    now.update = update;
    if (!jump_are_finite(deviation, 10)) jump_body.counts.not_finite++;
    else if (!force_program_solve(update, deviation, x)) jump_body.counts.not_solved++;
    else {
        now.has_good = 1;
        now.good = update;
        now.good_s = time_s;
        memset(now.forces, 0, sizeof now.forces);
        for (int v = 0; v < variables_of_update[update]; v++)
            now.forces[variable_step[update][v]][variable_force[update][v]] = x[v];
        memcpy(now.decided, now.forces[0], sizeof now.decided);
        return;
    }
    substitute(update, time_s);
}

/* The measured pose; where it is not finite the last one that was, or that of the plan. */
static void measure_pose(double time_s, const JumpEstimate *e) {
    if (jump_are_finite(e->base_quaternion, 4) && jump_are_finite(e->joint_pos, JOINTS)) {
        memcpy(now.quaternion, e->base_quaternion, sizeof now.quaternion);
        memcpy(now.joint_pos, e->joint_pos, sizeof now.joint_pos);
        now.has_pose = 1;
    } else if (!now.has_pose) {
        const double level[4] = {1, 0, 0, 0};
        memcpy(now.quaternion, level, sizeof level);
        memcpy(now.joint_pos, plan[jump_row_at(time_s)][0] + OF_POSITION, sizeof now.joint_pos);
    }
}

static double clip(double value, double least, double most) { return fmin(fmax(value, least), most); }

/* Torques and forces: those decided, or the plan's and what is decided beside them. */
static void feed_forward(double time_s, const double *row, JumpCommand *command) {
    const int pushes[2] = {time_s + ROUNDING_S < FRONT_LIFT_OFF_S, time_s + ROUNDING_S < TAKE_OFF_S};
    double force[2][3], feet[2][3], torque[JOINTS], within[2];
    if (DEPARTS && time_s <= LANDING_S) {
        memcpy(command->torque, row + OF_TORQUE, sizeof command->torque);
        memcpy(command->planned_force, row + OF_FORCE, sizeof command->planned_force);
    }
    if (!pushes[0] && !pushes[1]) return;
    for (int pair = 0; pair < 2; pair++) {
        const double *planned = command->planned_force + 2 * pair;
        for (int i = 0; i < 2; i++) within[i] = now.decided[2 * pair + i];
        if (DEPARTS) {
            for (int i = 0; i < 2; i++) within[i] += planned[i] - planned_force[now.update][2 * pair + i];
            within[1] = clip(within[1], SMALLEST_N, LARGEST_N);
            within[0] = clip(within[0], -FRICTION * within[1], FRICTION * within[1]);
            for (int i = 0; i < 2; i++) within[i] -= planned[i];
        }
        for (int i = 0; i < 2; i++) {
            within[i] *= pushes[pair];
            command->planned_force[2 * pair + i] += within[i];
            force[pair][i] = within[0] * jump_body.forward[i];
        }
        force[pair][2] = within[1];
    }
    jump_legs(now.quaternion, now.joint_pos, feet, (const double(*)[3])force, torque);
    for (int j = 0; j < JOINTS; j++) command->torque[j] += torque[j];
}

void jump_tick(const JumpEstimate *measured, JumpCommand *command) {
    JumpEstimate e = *measured;
    if (!jump_body_begin(&e, command)) return;
    const double time_s = e.time_s - jump_body.start_s;
    const int at = jump_row_at(time_s), moving = time_s <= LANDING_S;
    const double *row = plan[at][0];
    memset(command, 0, sizeof *command);
    if (time_s + ROUNDING_S < TAKE_OFF_S) {
        const int update = (int)clip((time_s + ROUNDING_S) / UPDATE_S, 0, UPDATES - 1);
        if (update >= now.updates) {
            now.updates = update + 1;
            decide(update, time_s, &e);
        }
        measure_pose(time_s, &e);
    }
    feed_forward(time_s, row, command);
    for (int j = 0; j < JOINTS; j++) {
        command->position[j] = row[OF_POSITION + j];
        command->velocity[j] = row[OF_VELOCITY + j] * moving;
        command->kp[j] = gains[gains_of_row[at]][0][j];
        command->kd[j] = gains[gains_of_row[at]][1][j];
    }
    jump_body_end(command);
}
