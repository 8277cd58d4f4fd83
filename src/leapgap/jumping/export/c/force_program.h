/* Quadratic program of one update of the learned MPC: the forces that bring the robot back to its plan. */
#ifndef FORCE_PROGRAM_H
#define FORCE_PROGRAM_H

#include "sizes.h"

/* Forces of the program's variables for a deviation, 6, from the plan; whether there is a solution to rely on. */
int force_program_solve(int update, const double deviation[6], double x[VARIABLES]);

#endif
