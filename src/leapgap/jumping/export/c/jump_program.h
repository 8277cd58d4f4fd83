/* Quadratic program of one update: the shift of the goal that brings the landing nearest to the target. */
#ifndef JUMP_PROGRAM_H
#define JUMP_PROGRAM_H

#include "sizes.h"

/* Change of the landing by the shift during each update. */
typedef struct {
    double by_update[UPDATES][3][3];
} JumpAuthority;

/* Goals, landings and shifts: x, z, pitch; m, m, rad. */
typedef struct {
    int update;
    const JumpAuthority *authority;
    const double *landing; /* predicted without a further change of the shift */
    const double *target;  /* where to land */
    const double *before;  /* shift so far */
    const double *change;  /* of goal and stance, 4, from those of the plan */
} JumpProgram;

/* Change of the shift at this update; whether the program has a solution. */
int jump_program_solve(const JumpProgram *program, double change[3]);

#endif
