/* Controller of one jump: call jump_tick once a control period, in order of time. No memory is allocated. */
#ifndef JUMP_CONTROLLER_H
#define JUMP_CONTROLLER_H

#include "sizes.h"

/* What is measured at one tick. World x forward, z up; SI units; what was not measured is NAN. */
typedef struct {
    double time_s;                   /* of any clock; the jump begins at the first tick after jump_reset */
    double base_position[3];         /* origin of the base in the world, m */
    double base_quaternion[4];       /* base to world, w x y z */
    double base_velocity[3];         /* of that origin, in the world, m/s */
    double base_angular_velocity[3]; /* in base axes, rad/s */
    double joint_pos[JOINTS];        /* rad */
} JumpEstimate;

/* Joint commands until the next tick: feed-forward torque and joint PD. */
typedef struct {
    double torque[JOINTS];   /* N m */
    double position[JOINTS]; /* rad */
    double velocity[JOINTS]; /* rad/s */
    double kp[JOINTS];       /* N m/rad */
    double kd[JOINTS];       /* N m s/rad */
    double planned_force[4]; /* ground on the robot, front x z, rear x z, N */
} JumpCommand;

/* Number of ticks or updates since jump_reset at which something out of the ordinary was sent. */
typedef struct {
    int time_not_usable; /* ticks: the last command was repeated, later the joints were damped */
    int not_finite;      /* updates: something was not measured, and what was decided before stays */
    int not_solved;      /* updates: the quadratic program has no solution, and the same */
    int limited;         /* ticks: the feed-forward was beyond the motors and was shrunk */
} JumpCounts;

void jump_reset(void);
void jump_tick(const JumpEstimate *measured, JumpCommand *command);
const JumpCounts *jump_counts(void);
/* What was decided last: the shift of the goal, x z pitch, m m rad, or the forces, front x z, rear x z, N. */
const double *jump_decided(void);

#endif
