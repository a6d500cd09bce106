/* This part is the square-root Kalman filter with the covariance L L'. Model and measurements are linearised at the
 * state x[k] and the noise u[k] of the plan, which may differ from the mean. */

/* Returns 1 if all numbers are finite and no state exceeds its scale by far. */
static int filter_is_sane(const filter_t *f)
{
    const real_t most = R(1) / (SQRT(TOL_UNIT) * SQRT(SQRT(TOL_UNIT)));
    int sane = all_finite(f->mean, NX) && all_finite(f->L[0], NX * NX);
    for (int i = 0; i < NX; i++) {
        sane &= FABS(f->mean[i]) <= most * z_scale[i];
    }
    return sane;
}

/* projected = f = L' h, with h P h' = f'f. */
static void project(const filter_t *f, const real_t *h, real_t *projected)
{
    (void)memset(projected, 0, NX * sizeof *projected);
    for (int i = 0; i < NX; i++) {
        for (int j = 0; j < NX; j++) {
            projected[j] += f->L[i][j] * h[i];
        }
    }
}

static real_t square_sum(const real_t *v, int n)
{
    real_t sum = R(0);
    for (int i = 0; i < n; i++) {
        sum += v[i] * v[i];
    }
    return sum;
}

/* Returns the standard deviation sqrt(h P h' + own^2) of an innovation, where h is the gradient of the measurement. */
static real_t expected_deviation(const filter_t *f, const real_t *h, real_t own)
{
    real_t projected[NX];
    project(f, h, projected);
    return SQRT(own * own + square_sum(projected, NX));
}

/* Returns the error of a measurement at the mean of the filter from its error at x, by its slope h. */
static real_t error_at_mean(const filter_t *f, const real_t *x, const real_t *h, real_t error)
{
    for (int i = 0; i < NX; i++) {
        error -= h[i] * (f->mean[i] - x[i]);
    }
    return error;
}

/* Updates the filter with one measurement of slope h and variance `own`, which is `error` above its prediction
 * (Potter). */
static void take_measurement(filter_t *f, const real_t *h, real_t error, real_t own)
{
    real_t p[NX];
    project(f, h, p);
    const real_t total = own + square_sum(p, NX), factor = R(1) / (total + SQRT(total) * SQRT(own));
    for (int i = 0; i < NX; i++) {
        real_t gain = R(0);
        for (int j = 0; j < NX; j++) {
            gain += f->L[i][j] * p[j];
        }
        f->mean[i] += gain * error / total;
        for (int j = 0; j < NX; j++) {
            f->L[i][j] -= factor * gain * p[j];
        }
    }
}

/* Updates the filter with the measurements of node k that are not missing. */
static void update_filter(const solver_t *s, int k, filter_t *f)
{
    const real_t *p = PARAM(s, k);
    real_t y[NM], H[NM][NX] = {{R(0)}};
    MEASUREMENT(s->x[k], PARAM(s, k), y, H);
    for (int m = 0; m < NM; m++) {
        const real_t inverse = p[AT_ACCURACY + m];
        if (inverse > R(0)) {
            const real_t error = error_at_mean(f, s->x[k], H[m], p[AT_Y + m] - y[m]);
            take_measurement(f, H[m], error, R(1) / (inverse * inverse));
        }
    }
}

/* Reduces the first NX columns of M to lower triangular form, and the others to 0, by reflections from the right that
 * keep M M'. */
static void triangulate(real_t M[NX][NZ])
{
    for (int i = 0; i < NX; i++) {
        const real_t norm = SQRT(square_sum(&M[i][i], NZ - i)), head = M[i][i];
        if (!(norm > R(0))) {
            continue;
        }
        M[i][i] = (head > R(0)) ? head + norm : head - norm;
        for (int r = i + 1; r < NX; r++) {
            real_t dot = R(0);
            for (int j = i; j < NZ; j++) {
                dot += M[r][j] * M[i][j];
            }
            dot /= norm * (norm + FABS(head));
            for (int j = i; j < NZ; j++) {
                M[r][j] -= dot * M[i][j];
            }
        }
        M[i][i] = (head > R(0)) ? -norm : norm;
        for (int j = i + 1; j < NZ; j++) {
            M[i][j] = R(0);
        }
    }
}

/* Moves the filter from node k to the next one. */
static void predict_filter(const solver_t *s, int k, filter_t *f)
{
    real_t next[NX], S[NX][NZ] = {{R(0)}}, M[NX][NZ] = {{R(0)}}, left[NX];
    INTEGRATOR_INTERVAL(s, k, next, S, left);
    for (int i = 0; i < NX; i++) {
        for (int l = 0; l < NX; l++) {
            next[i] += S[i][l] * (f->mean[l] - s->x[k][l]);
            for (int j = 0; j < NX; j++) {
                M[i][j] += S[i][l] * f->L[l][j];
            }
        }
        for (int j = 0; j < NU; j++) {
            next[i] -= S[i][NX + j] * s->u[k][j];
            M[i][NX + j] = S[i][NX + j] * process_std[j];
        }
    }
    triangulate(M);
    for (int i = 0; i < NX; i++) {
        f->mean[i] = next[i];
        (void)memcpy(f->L[i], M[i], sizeof f->L[i]);
    }
}

/* Sets the filter to the declared initial state and its standard deviations. */
static void restart_filter(filter_t *f)
{
    (void)memset(f, 0, sizeof *f);
    for (int i = 0; i < NX; i++) {
        f->mean[i] = initial_state[i];
        f->L[i][i] = initial_std[i];
    }
}

/* Computes the factor L of a covariance, L L' = P. Returns 0 if P is not symmetric and positive semidefinite, up to
 * rounding. */
static int factorize_covariance(const real_t *P, real_t L[NX][NX])
{
    for (int i = 0; i < NX; i++) {
        for (int j = 0; j < NX; j++) {
            real_t rest = P[i * NX + j];
            const real_t size = SQRT(FABS(P[i * NX + i])) * SQRT(FABS(P[j * NX + j]));
            if (!isfinite(rest) || FABS(rest - P[j * NX + i]) > TOL_ZERO * size) {
                return 0;
            }
            for (int l = 0; l < j && l < i; l++) {
                rest -= L[i][l] * L[j][l];
            }
            if (j > i) {
                L[i][j] = R(0);
            } else if (j == i) {
                if (rest < -TOL_ZERO * size) {
                    return 0;
                }
                L[i][i] = (rest > R(0)) ? SQRT(rest) : R(0);
            } else if (L[j][j] > R(0)) {
                L[i][j] = rest / L[j][j];
            } else {
                if (FABS(rest) > SQRT(TOL_ZERO) * size) {
                    return 0;
                }
                L[i][j] = R(0);
            }
        }
    }
    return 1;
}

/* P = L L'. */
static void multiply_factors(const filter_t *f, real_t *P)
{
    for (int i = 0; i < NX; i++) {
        for (int j = 0; j < NX; j++) {
            real_t sum = R(0);
            for (int l = 0; l < NX; l++) {
                sum += f->L[i][l] * f->L[j][l];
            }
            P[i * NX + j] = sum;
        }
    }
}
