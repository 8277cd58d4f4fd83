/* See force_program.h. The first forces u0 enter the state after the first step, x1 = free + E u0; all later forces are
   tabled as functions of it. Limits are rows with at most two forces, a . (u0, U) <= b. Their dual problem is solved by the
   active-set method of Goldfarb and Idnani (1983), from the rows that are active at the plan. */
#include "force_program.h"

#include <math.h>
#include <string.h>

#include "tables.h"

#define FIRST 4              /* most forces of the first step */
#define VIOLATION_N 1e-7     /* of a limit, that counts as none */
#define INDEPENDENT 1e-12    /* share of a row that must not depend on the active ones */

static struct {
    int update, first, later, rows;
    double free[6], enters[FIRST][6], inverse[FIRST][FIRST];
    double unlimited[LIMITS], correction[FIRST][LIMITS];
    int size, active[VARIABLES + 1];
    double multiplier[VARIABLES + 1], column[VARIABLES + 1][LIMITS], factor[VARIABLES + 1][VARIABLES + 1];
} qp;

/* Entry i of two of a row: which variable, and its factor; 0 where there is none. */
static double part(int row, int i, int *variable) {
    *variable = limit_variable[qp.update][row][i];
    return limit_factor[qp.update][row][i];
}

/* Change of the limits' rows by the later forces when a row's multiplier grows: its row of A H^-1 A', and Y S^-1 Y'. */
static void set_column(int row, double column[LIMITS]) {
    double by_later[VARIABLES] = {0};
    for (int i = 0, v; i < 2; i++) {
        const double factor = part(row, i, &v);
        if (factor != 0 && v >= qp.first)
            for (int k = 0; k < qp.later; k++) by_later[k] += factor * later_inverse[qp.update][v - qp.first][k];
    }
    for (int c = 0; c < qp.rows; c++) {
        column[c] = 0;
        for (int i = 0, v; i < 2; i++) {
            const double factor = part(c, i, &v);
            if (factor != 0 && v >= qp.first) column[c] += factor * by_later[v - qp.first];
        }
        for (int j = 0; j < qp.first; j++) column[c] += qp.correction[j][row] * qp.correction[j][c];
    }
}

/* Rows begin ... size - 1 of the Cholesky factor of the active rows' matrix; whether it is regular. */
static int extend(int begin) {
    for (int i = begin; i < qp.size; i++) {
        double total = 0;
        for (int j = 0; j <= i; j++) {
            total = qp.column[i][qp.active[j]];
            for (int k = 0; k < j; k++) total -= qp.factor[i][k] * qp.factor[j][k];
            if (j < i) qp.factor[i][j] = total / qp.factor[j][j];
        }
        if (!(total > INDEPENDENT * qp.column[i][qp.active[i]])) return 0;
        qp.factor[i][i] = sqrt(total);
    }
    return 1;
}

/* y with factor factor' y = right, in its place; the square of factor^-1 right. */
static double solve_factored(double *y) {
    double squared = 0;
    for (int i = 0; i < qp.size; i++) {
        for (int k = 0; k < i; k++) y[i] -= qp.factor[i][k] * y[k];
        y[i] /= qp.factor[i][i];
        squared += y[i] * y[i];
    }
    for (int i = qp.size - 1; i >= 0; i--) {
        y[i] /= qp.factor[i][i];
        for (int k = 0; k < i; k++) y[k] -= qp.factor[i][k] * y[i];
    }
    return squared;
}

static void release(int leaves) {
    qp.size--;
    for (int i = leaves; i < qp.size; i++) {
        qp.active[i] = qp.active[i + 1];
        qp.multiplier[i] = qp.multiplier[i + 1];
        memcpy(qp.column[i], qp.column[i + 1], sizeof *qp.column);
    }
    extend(leaves);
}

/* Rows that are active at the plan, without those whose multipliers are negative today. */
static int begin(void) {
    qp.size = starts_of_update[qp.update];
    for (int i = 0; i < qp.size; i++) {
        qp.active[i] = start_row[qp.update][i];
        set_column(qp.active[i], qp.column[i]);
    }
    if (!extend(0)) return 0;
    while (qp.size > 0) {
        int least = 0;
        for (int i = 0; i < qp.size; i++) qp.multiplier[i] = qp.unlimited[qp.active[i]];
        solve_factored(qp.multiplier);
        for (int i = 1; i < qp.size; i++)
            if (qp.multiplier[i] < qp.multiplier[least]) least = i;
        if (qp.multiplier[least] >= 0) return 1;
        release(least);
    }
    return 1;
}

/* Make a violated row hold, releasing others where they are in the way; whether that is possible. */
static int enforce(int row, double violation) {
    const int most = qp.first + qp.later;
    double column[LIMITS], added = 0;
    set_column(row, column);
    for (;;) {
        double by_active[VARIABLES + 1];
        int leaves = -1;
        for (int i = 0; i < qp.size; i++) by_active[i] = column[qp.active[i]];
        const double along = column[row] - solve_factored(by_active);
        double step = qp.size < most && along > INDEPENDENT * column[row] ? violation / along : INFINITY;
        for (int i = 0; i < qp.size; i++)
            if (by_active[i] > 0 && qp.multiplier[i] < step * by_active[i]) {
                step = qp.multiplier[i] / by_active[i];
                leaves = i;
            }
        if (!(step < INFINITY)) return 0;
        for (int i = 0; i < qp.size; i++) qp.multiplier[i] -= step * by_active[i];
        added += step;
        violation -= step * along;
        if (leaves < 0) break;
        release(leaves);
    }
    qp.active[qp.size] = row;
    qp.multiplier[qp.size] = added;
    memcpy(qp.column[qp.size++], column, sizeof column);
    return extend(qp.size - 1);
}

/* Multipliers of the limits; whether they are those of the minimum. */
static int solve_dual(void) {
    if (!begin()) return 0;
    for (int iteration = 0; iteration < LARGEST_ITERATIONS; iteration++) {
        double left[LIMITS];
        int worst = 0;
        memcpy(left, qp.unlimited, sizeof left);
        for (int i = 0; i < qp.size; i++)
            for (int c = 0; c < qp.rows; c++) left[c] -= qp.multiplier[i] * qp.column[i][c];
        for (int c = 1; c < qp.rows; c++)
            if (left[c] > left[worst]) worst = c;
        if (!(left[worst] > VIOLATION_N)) return left[worst] <= VIOLATION_N;
        if (!enforce(worst, left[worst])) return 0;
    }
    return 0;
}

/* State after the first step without forces, and its change by each of the first forces. */
static void set_first_state(const double deviation[6]) {
    const int u = qp.update;
    const double step_s = first_step_s[u];
    for (int i = 0; i < 3; i++) {
        double acceleration = first_model[u][i];
        for (int k = 0; k < 6; k++) acceleration += first_by_state[u][i][k] * deviation[k];
        const double gained = step_s * acceleration;
        qp.free[i] = deviation[i] + step_s * (deviation[3 + i] + CURVATURE * gained);
        qp.free[3 + i] = deviation[3 + i] + gained;
        for (int j = 0; j < qp.first; j++) {
            qp.enters[j][3 + i] = first_model[u][3 + 4 * i + variable_force[u][j]] * first_push_s[u][j];
            qp.enters[j][i] = CURVATURE * step_s * qp.enters[j][3 + i];
        }
    }
}

/* The first forces without limits, and L^-1 of their Hessian L L'; whether that is positive. */
static int set_unlimited(double *force) {
    const int u = qp.update, m = qp.first;
    double slope[6], curved[FIRST][6] = {{0}}, hessian[FIRST][FIRST] = {{0}}, L[FIRST][FIRST] = {{0}};
    for (int k = 0; k < 6; k++) {
        slope[k] = slope_to_go[u][k];
        for (int i = 0; i < 6; i++) slope[k] += qp.free[i] * cost_to_go[u][i][k];
    }
    for (int j = 0; j < m; j++) {
        force[j] = 2 * FORCE_WEIGHT * planned_force[u][variable_force[u][j]];
        for (int k = 0; k < 6; k++) {
            for (int i = 0; i < 6; i++) curved[j][k] += qp.enters[j][i] * cost_to_go[u][i][k];
            force[j] -= qp.enters[j][k] * slope[k];
            for (int i = 0; i < m; i++) hessian[j][i] += curved[j][k] * qp.enters[i][k];
        }
        hessian[j][j] += 2 * FORCE_WEIGHT;
    }
    for (int i = 0; i < m; i++)
        for (int j = 0; j <= i; j++) {
            double total = hessian[i][j];
            for (int k = 0; k < j; k++) total -= L[i][k] * L[j][k];
            if (i == j && !(total > INDEPENDENT * hessian[i][i])) return 0;
            L[i][j] = i == j ? sqrt(total) : total / L[j][j];
        }
    memset(qp.inverse, 0, sizeof qp.inverse);
    for (int i = 0; i < m; i++)
        for (int j = 0; j <= i; j++) {
            double total = i == j;
            for (int k = j; k < i; k++) total -= L[i][k] * qp.inverse[k][j];
            qp.inverse[i][j] = total / L[i][i];
        }
    for (int i = 0; i < m; i++) {
        for (int k = 0; k < i; k++) force[i] -= L[i][k] * force[k];
        force[i] /= L[i][i];
    }
    for (int i = m - 1; i >= 0; i--) {
        force[i] /= L[i][i];
        for (int k = 0; k < i; k++) force[k] -= L[i][k] * force[i];
    }
    return 1;
}

/* By how much the forces without limits violate each row, and what the first forces' multipliers change there. */
static void set_rows(const double *force) {
    const int u = qp.update;
    for (int c = 0; c < qp.rows; c++) {
        double by_state[6] = {0}, by_first[FIRST] = {0};
        qp.unlimited[c] = -limit_bound[u][c];
        for (int i = 0, v; i < 2; i++) {
            const double factor = part(c, i, &v);
            if (factor == 0) continue;
            if (v < qp.first) by_first[v] += factor;
            else {
                qp.unlimited[c] += factor * later_force[u][v - qp.first];
                for (int k = 0; k < 6; k++) by_state[k] += factor * later_by_state[u][k][v - qp.first];
            }
        }
        for (int k = 0; k < 6; k++) {
            qp.unlimited[c] += qp.free[k] * by_state[k];
            for (int j = 0; j < qp.first; j++) by_first[j] += qp.enters[j][k] * by_state[k];
        }
        for (int j = 0; j < qp.first; j++) {
            qp.unlimited[c] += force[j] * by_first[j];
            qp.correction[j][c] = 0;
            for (int k = 0; k <= j; k++) qp.correction[j][c] += qp.inverse[j][k] * by_first[k];
        }
    }
}

/* Whether forces and multipliers meet the conditions of a minimum of the problem itself, within the tolerances. */
static int is_minimum(const double *x) {
    const int u = qp.update, n = qp.first + qp.later;
    double z[6 + VARIABLES], slope[6 + VARIABLES], at_rest[6 + VARIABLES], left[VARIABLES] = {0}, largest = 0;
    for (int c = 0; c < qp.rows; c++) {
        double beyond = -limit_bound[u][c];
        for (int i = 0, v; i < 2; i++) {
            const double factor = part(c, i, &v);
            if (factor != 0) beyond += factor * x[v];
        }
        if (!(beyond <= TOLERANCE_N)) return 0;
    }
    for (int k = 0; k < 6; k++) {
        z[k] = qp.free[k];
        for (int j = 0; j < qp.first; j++) z[k] += qp.enters[j][k] * x[j];
    }
    memcpy(z + 6, x + qp.first, qp.later * sizeof *z);
    for (int i = 0; i < 6 + qp.later; i++) {
        slope[i] = at_rest[i] = cost_slope[u][i];
        for (int k = 0; k < 6; k++) at_rest[i] += qp.free[k] * cost[u][k][i];
        for (int k = 0; k < 6 + qp.later; k++) slope[i] += z[k] * cost[u][k][i];
    }
    for (int i = 0; i < qp.size; i++)
        for (int k = 0, v; k < 2; k++) {
            const double factor = part(qp.active[i], k, &v);
            if (factor != 0) left[v] += qp.multiplier[i] * factor;
        }
    for (int j = 0; j < n; j++) {
        double given = j < qp.first ? -2 * FORCE_WEIGHT * planned_force[u][variable_force[u][j]] : at_rest[6 + j - qp.first];
        if (j < qp.first) {
            left[j] += given + 2 * FORCE_WEIGHT * x[j];
            for (int k = 0; k < 6; k++) {
                left[j] += qp.enters[j][k] * slope[k];
                given += qp.enters[j][k] * at_rest[k];
            }
        } else left[j] += slope[6 + j - qp.first];
        largest = fmax(largest, fabs(given));
    }
    for (int j = 0; j < n; j++)
        if (!(fabs(left[j]) <= RELATIVE_TOLERANCE * (1 + largest))) return 0;
    return 1;
}

int force_program_solve(int update, const double deviation[6], double x[VARIABLES]) {
    double ends[6];
    qp.update = update;
    qp.first = firsts_of_update[update];
    qp.later = variables_of_update[update] - qp.first;
    qp.rows = limits_of_update[update];
    set_first_state(deviation);
    if (!set_unlimited(x)) return 0;
    set_rows(x);
    if (!solve_dual()) return 0;
    for (int k = 0; k < qp.later; k++) x[qp.first + k] = later_force[update][k];
    for (int i = 0; i < qp.size; i++) {
        for (int j = 0; j < qp.first; j++)
            for (int k = 0; k <= j; k++)
                x[k] -= qp.inverse[j][k] * qp.correction[j][qp.active[i]] * qp.multiplier[i];
        for (int l = 0, v; l < 2; l++) {
            const double factor = part(qp.active[i], l, &v);
            if (factor == 0 || v < qp.first) continue;
            for (int k = 0; k < qp.later; k++)
                x[qp.first + k] -= qp.multiplier[i] * factor * later_inverse[update][v - qp.first][k];
        }
    }
    for (int k = 0; k < 6; k++) {
        ends[k] = qp.free[k];
        for (int j = 0; j < qp.first; j++) ends[k] += x[j] * qp.enters[j][k];
    }
    for (int k = 0; k < 6; k++)
        for (int i = 0; i < qp.later; i++) x[qp.first + i] += ends[k] * later_by_state[update][k][i];
    return is_minimum(x);
}
