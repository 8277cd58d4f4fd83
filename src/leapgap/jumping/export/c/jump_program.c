/* See jump_program.h. Dual active-set method of Goldfarb and Idnani (1983): min 1/2 x'Hx + g'x, a_i x <= b_i. Variables: the
   shifts of all steps, then slacks of pitch, height and effort. Constraints: upper bounds, lower bounds, landing, efforts,
   each scaled by its norm in the Hessian of the plan. */
#include "jump_program.h"

#include <math.h>
#include <string.h>

#include "tables.h"

#define LANDING_ROWS 3 /* limits of pitch, upwards and downwards, and of height */
#define CONSTRAINTS (2 * VARIABLES + LANDING_ROWS + LARGEST_EFFORTS)
#define VIOLATION 1e-9 /* of a constraint, scaled, that counts as none */
#define DEPENDENT 1e-18
#define LARGEST_ITERATIONS 500

static struct {
    int n, update, q;
    double x[VARIABLES], gradient[VARIABLES], lower[VARIABLES], upper[VARIABLES], hessian[VARIABLES][VARIABLES];
    double landing[LANDING_ROWS], landing_row[LANDING_ROWS][VARIABLES], room[LARGEST_EFFORTS];
    double J[VARIABLES][VARIABLES], R[VARIABLES][VARIABLES], d[VARIABLES], u[VARIABLES]; /* J J' = 1/H */
    int active[VARIABLES];
    unsigned char is_active[CONSTRAINTS];
} qp;

static double slack_of(int c) {
    const int n = qp.n, u = qp.update;
    if (c < n) return (qp.upper[c] - qp.x[c]) * bound_scale[u][c];
    if (c < 2 * n) return (qp.x[c - n] - qp.lower[c - n]) * bound_scale[u][c - n];
    c -= 2 * n;
    if (c < LANDING_ROWS) {
        double left = qp.landing[c];
        for (int i = 0; i < n; i++) left -= qp.landing_row[c][i] * qp.x[i];
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
        for (int i = 0; i < n; i++) a[i] = -qp.landing_row[c - 2 * n][i];
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

/* J from the Cholesky factor of H; whether H is positive definite. */
static int factor(void) {
    const int n = qp.n;
    double L[VARIABLES][VARIABLES];
    memset(qp.J, 0, sizeof qp.J);
    for (int j = 0; j < n; j++)
        for (int i = j; i < n; i++) {
            double sum = qp.hessian[i][j];
            for (int k = 0; k < j; k++) sum -= L[i][k] * L[j][k];
            if (i == j && !(sum > 0)) return 0;
            L[i][j] = i == j ? sqrt(sum) : sum / L[j][j];
        }
    for (int j = 0; j < n; j++) { /* row j of J is column j of 1/L */
        qp.J[j][j] = 1 / L[j][j];
        for (int i = j + 1; i < n; i++) {
            double sum = 0;
            for (int k = j; k < i; k++) sum -= L[i][k] * qp.J[j][k];
            qp.J[j][i] = sum / L[i][i];
        }
    }
    return 1;
}

/* Solve the program; whether it has a solution. */
static int solve(void) {
    const int n = qp.n, u = qp.update;
    const int constraints = 2 * n + LANDING_ROWS + efforts_of_update[u + 1] - efforts_of_update[u];
    double image[VARIABLES] = {0};
    int iterations = 0;
    if (!factor()) return 0;
    qp.q = 0;
    memset(qp.is_active, 0, sizeof qp.is_active);
    for (int i = 0; i < n; i++)
        for (int j = i; j < n; j++) image[j] -= qp.J[i][j] * qp.gradient[i];
    for (int i = 0; i < n; i++) {
        qp.x[i] = 0;
        for (int j = i; j < n; j++) qp.x[i] += qp.J[i][j] * image[j];
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

/* Cost and limits of the landing by what the shift of each step does to it, and by how much that may be off. */
static void set_landing(const JumpProgram *p, const double miss[3]) {
    const int u = p->update, shifts = qp.n - 3;
    const double by_row[LANDING_ROWS] = {1, -1, -1};
    const int axis_of_row[LANDING_ROWS] = {2, 2, 1};
    double effect[3][VARIABLES] = {{0}}, later[3][VARIABLES] = {{0}}; /* of a step; its change with time */
    for (int step = 0; step < steps_of_update[u]; step++)
        for (int t = edges_of_update[u][step]; t < edges_of_update[u][step + 1]; t++) {
            const int first = t > 0 ? t - 1 : 0, last = t + 1 < UPDATES ? t + 1 : UPDATES - 1;
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++) {
                    const double *of_first = p->authority->by_update[first][i], *of_last = p->authority->by_update[last][i];
                    effect[i][3 * step + j] += p->authority->by_update[t][i][j];
                    later[i][3 * step + j] += (of_last[j] - of_first[j]) / (last - first);
                }
        }
    const double acts = u < FREE_UPDATES; /* a shift without an effect stays as it is */
    for (int r = 0; r < qp.n; r++) {
        qp.gradient[r] = 0;
        for (int c = 0; c < qp.n; c++) qp.hessian[r][c] = hessian[u][r][c];
        for (int i = 0; r < shifts && i < 3; i++) {
            const double weight = 1 / (matters_of_target[i] * matters_of_target[i]);
            qp.gradient[r] += acts * weight * effect[i][r] * miss[i];
            for (int c = 0; c < shifts; c++) qp.hessian[r][c] += acts * weight * effect[i][r] * effect[i][c];
            for (int c = r % 3; c < shifts; c += 3)
                qp.hessian[r][c] += weight * (AUTHORITY_DOUBT * AUTHORITY_DOUBT * effect[i][r] * effect[i][c] +
                                              TIMING_DOUBT * TIMING_DOUBT * later[i][r] * later[i][c]);
        }
    }
    for (int c = 0; c < LANDING_ROWS; c++) {
        memset(qp.landing_row[c], 0, sizeof qp.landing_row[c]);
        for (int i = 0; i < shifts; i++)
            qp.landing_row[c][i] = acts * by_row[c] * effect[axis_of_row[c]][i] * landing_row_scale[u][c];
        qp.landing_row[c][shifts + (c == 2)] = -landing_soft[c] * landing_row_scale[u][c];
    }
}

/* Distance to the limits of forces and torques. */
static void set_efforts(const JumpProgram *p) {
    for (int e = efforts_of_update[p->update]; e < efforts_of_update[p->update + 1]; e++) {
        double room = effort_room[e];
        for (int axis = 0; axis < AXES; axis++)
            room -= effort_slope[e][axis] * (p->change[axis] + (axis < 3 ? p->before[axis] : 0));
        qp.room[e - efforts_of_update[p->update]] = room > 0 ? room : 0;
    }
}

int jump_program_solve(const JumpProgram *p, double change[3]) {
    const int u = p->update, shifts = 3 * steps_of_update[u], n = shifts + 3;
    double miss[3];
    qp.update = u;
    qp.n = n;
    for (int i = 0; i < 3; i++) miss[i] = p->landing[i] - p->target[i];
    for (int i = 0; i < n; i++) {
        qp.upper[i] = i < shifts ? largest_shift[i % 3] - p->before[i % 3] : INFINITY;
        qp.lower[i] = i < shifts ? -largest_shift[i % 3] - p->before[i % 3] : 0;
    }
    for (int i = 0; i < 3; i++) {
        qp.upper[i] = fmin(qp.upper[i], largest_change[i]);
        qp.lower[i] = fmax(qp.lower[i], -largest_change[i]);
    }
    set_landing(p, miss);
    qp.landing[0] = (LARGEST_PITCH_RAD - p->landing[2]) * landing_row_scale[u][0];
    qp.landing[1] = (LARGEST_PITCH_RAD + p->landing[2]) * landing_row_scale[u][1];
    qp.landing[2] = (BELOW_TARGET_M + miss[1]) * landing_row_scale[u][2];
    set_efforts(p);
    if (!solve()) return 0;
    memcpy(change, qp.x, 3 * sizeof *change);
    return 1;
}
