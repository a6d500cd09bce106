/* One closed loop connects a controller and its plant. Structs are opaque: call_step, call_integrate and hand_over call
 * the functions of their packages. */

/* Returns the value of a flight at a sample; the last row holds for all later samples. */
TARGET static real_t batch_value_at(const batch_column_t *c, int64_t flight, int64_t sample)
{
    const int64_t row = (sample < c->rows) ? sample : c->rows - 1;
    return ((const real_t *)((const char *)c->values + flight * c->flight_step))[row];
}

/* Copies the stored rows, with the values of a sample in the columns that have some. A row takes the values of the
 * sample at the time of its node. For bounds, the lower ones of all nodes come first. */
TARGET static void batch_gather(const batch_data_t *d, const char *s, int64_t flight, int64_t k, real_t *rows)
{
    const int bounds = d->setter == BATCH_BOUNDS;
    const int64_t node = bounds ? 1 : d->width, column = bounds ? d->nodes : 1;
    for (int32_t n = 0; n < d->nodes; n++) {
        if (!bounds) {
            memcpy(rows + n * node, s + d->offset + n * d->row_step, (size_t)d->width * sizeof(real_t));
        }
        for (int32_t i = 0; i < d->count; i++) {
            rows[n * node + d->columns[i].column * column] = batch_value_at(&d->columns[i], flight, k + d->ahead[n]);
        }
    }
}

/* Sets the data of sample k. Data that hold in all samples are set before the first one, unless others set them,
 * too. */
TARGET static int32_t batch_tell(
    const batch_flights_t *f, const batch_place_t *place, void *s, int64_t flight, int64_t k, real_t *rows)
{
    for (int32_t i = 0; i < place->count; i++) {
        const batch_data_t *d = &place->data[i];
        int changes = k == 0 || f->tells_all;
        for (int32_t j = 0; j < d->count; j++) {
            changes |= d->columns[j].rows > 1;
        }
        if (changes) {
            batch_gather(d, (const char *)s, flight, k, rows);
            const int32_t refused = batch_hand_over(d, s, rows);
            if (refused) {
                return refused;
            }
        }
    }
    return 0;
}

/* Moves the plant by a sample. Returns 0 if its state is not finite. */
TARGET static int batch_move(const batch_flights_t *f, const void *plant, const real_t *u, double *x)
{
    int finite = 1;
    for (int32_t piece = 0; piece < f->pieces; piece++) {
        real_t start[NX], next[NX];
        for (int i = 0; i < NX; i++) {
            start[i] = (real_t)x[i];
        }
        batch_call_integrate(f, plant, start, u, (real_t)f->dt, next);
        for (int i = 0; i < NX; i++) {
            x[i] = (double)next[i];
            finite &= isfinite(x[i]) != 0;
        }
    }
    return finite;
}

/* Computes the algebraic variables at a sample. */
TARGET static void batch_evaluate_algebraic(
    const batch_flights_t *f, void *s, const double *x, const real_t *u, double *z)
{
    real_t start[NX], found[NALG];
    for (int i = 0; i < NX; i++) {
        start[i] = (real_t)x[i];
    }
    batch_call_algebraic(f, s, start, u, found);
    for (int i = 0; i < f->algebraic_count; i++) {
        z[i] = (double)found[i];
    }
}

/* Adds the disturbances to the state after sample k of a flight. */
TARGET static void batch_disturb(const batch_flights_t *f, int64_t flight, int64_t k, double *x)
{
    if (f->disturbance.size != NULL) {
        double d[NX];
        batch_draw_sample(&f->disturbance, f->seed, f->number + flight, k, NX, d);
        for (int i = 0; i < NX; i++) {
            x[i] += d[i];
        }
    }
    if (f->given != NULL) {
        const double *d = (const double *)((const char *)f->given + flight * f->given_step) + k * NX;
        for (int i = 0; i < NX; i++) {
            x[i] += d[i];
        }
    }
}

/* Computes the state that the controller receives. */
TARGET static void batch_measure(const batch_flights_t *f, int64_t flight, int64_t k, const double *x, real_t *xhat)
{
    double noise[NX];
    for (int i = 0; i < NX; i++) {
        noise[i] = 0.0;
    }
    if (f->noise.size != NULL) {
        batch_draw_sample(&f->noise, f->seed, f->number + flight, k, NX, noise);
    }
    for (int i = 0; i < NX; i++) {
        xhat[i] = (real_t)(x[i] + noise[i]);
    }
}

/* Sets the data of sample k of a flight: those of its controller, then those of a separate plant. */
TARGET static int32_t batch_tell_both(
    const batch_flights_t *f, int64_t flight, int64_t k, void *s, void *plant, real_t *rows)
{
    const int32_t refused = batch_tell(f, &f->controller, s, flight, k, rows);
    return (refused || plant == s) ? refused : batch_tell(f, &f->plant, plant, flight, k, rows);
}

/* Runs sample k of a flight, which writes to index `at` of the arrays; xhat: the state that the controller receives.
 * Returns 0, or the status of a setter that has refused data. */
TARGET static int32_t batch_fly_one_sample(
    const batch_flights_t *f, int64_t flight, int64_t at, int64_t k, void *s, void *plant, real_t *rows, real_t *xhat)
{
    const double *now = f->x + (at * (f->steps + 1) + k) * NX;
    double *next = f->x + (at * (f->steps + 1) + k + 1) * NX, *u = f->u + (at * f->steps + k) * NU;
    double *seconds = f->seconds + 2 * at;
    real_t control[NU];
    const int32_t refused = batch_tell_both(f, flight, k, s, plant, rows);
    if (refused) {
        return refused;
    }
    batch_measure(f, flight, k, now, xhat);
    const double begin = batch_now();
    const int32_t status = batch_call_step(f, s, xhat, control);
    const double took = batch_now() - begin;
    f->status[at * f->steps + k] = (int8_t)status;
    seconds[0] += took;
    seconds[1] = (took < seconds[1]) ? seconds[1] : took;
    if (f->failed[at] < 0 && (f->failures >> status & 1u)) {
        f->failed[at] = k;
    }
    for (int j = 0; j < NU; j++) {
        u[j] = (double)control[j];
    }
    if (f->algebraic_count) {
        const int64_t place = (at * f->steps + k) * f->algebraic_count;
        batch_evaluate_algebraic(f, f->plant_is_true ? plant : s, now, control, f->z + place);
    }
    if (f->known_size) {
        memcpy((char *)plant + f->known, (const char *)s + f->known, (size_t)f->known_size);
    }
    memcpy(next, now, (size_t)NX * sizeof *next);
    if (batch_move(f, plant, control, next)) {
        batch_disturb(f, flight, k, next);
    } else {
        f->lost[at] = k;
    }
    return 0;
}

/* Runs a flight, which writes to index `at` of the arrays. Returns 0, the status of a setter that has refused data, or
 * -1 if it was stopped. A flight ends where its state is not finite; its further samples stay as they are. */
TARGET static int32_t batch_fly_one(
    const batch_flights_t *f, int64_t flight, int64_t at, void *s, void *plant, real_t *rows)
{
    real_t xhat[NX];
    f->failed[at] = f->lost[at] = -1;
    f->seconds[2 * at] = f->seconds[2 * at + 1] = 0.0;
    memcpy(f->x + at * (f->steps + 1) * NX, f->x0 + flight * NX, (size_t)NX * sizeof *f->x);
    for (int64_t k = 0; k < f->steps && f->lost[at] < 0; k++) {
        if (f->stop != NULL && *f->stop) {
            return -1;
        }
        const int32_t refused = batch_fly_one_sample(f, flight, at, k, s, plant, rows, xhat);
        if (refused) {
            return refused;
        }
    }
    return 0;
}
