/* What the controllers of all jumps share: which measurements are used, the frame of the start, legs, motors. */
#ifndef JUMP_BODY_H
#define JUMP_BODY_H

#include "jump_controller.h"

#define ROUNDING_S 1e-6

typedef struct {
    int started, framed, has_used, has_last, ticks_since_used;
    double used_s, seen_s, offset_s, start_s;
    double x, y, level, forward[2]; /* frame of the start: position, height of the plan's zero, heading */
    JumpCommand last;
    JumpCounts counts;
} JumpBody;

extern JumpBody jump_body;

void jump_body_reset(void);
/* Begin a tick: whether its estimate, made possible, can be used; else the command to send is written. */
int jump_body_begin(JumpEstimate *e, JumpCommand *command);
/* End a tick: the command, within what the motors can do, is the last one. */
void jump_body_end(JumpCommand *command);
int jump_are_finite(const double *values, int count);
/* Row of the plan nearest to a time since the start. */
int jump_row_at(double time_s);
/* Mean foot - base of each pair, front and rear, in world axes, and joint torques -J'u of pair forces u, or none. */
void jump_legs(const double quaternion[4], const double joint_pos[JOINTS], double feet[2][3], const double (*force)[3],
               double *torque);
/* x z pitch and their rates, and feet, front x z, rear x z, in the frame of the start. */
void jump_planar(const JumpEstimate *e, double planar[10]);

#endif
