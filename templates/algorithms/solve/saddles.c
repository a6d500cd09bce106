/* The search leaves saddles. */

#if SOLVE
/* Saves the plan at the saddle, with its multipliers. */
static void keep_saddle(solver_t *s)
{
    saddle_t *q = &s->saddle;
    (void)memcpy(q->x, s->x, sizeof q->x);
    (void)memcpy(q->u, s->u, sizeof q->u);
    (void)memcpy(q->lam, s->lam, sizeof q->lam);
    (void)memcpy(q->mu_u, s->mu_u, sizeof q->mu_u);
    (void)memcpy(q->mult, s->mult, sizeof q->mult);
    q->cost = cost_of_plan(s);
}

static void return_to_saddle(solver_t *s)
{
    const saddle_t *q = &s->saddle;
    (void)memcpy(s->x, q->x, sizeof q->x);
    (void)memcpy(s->u, q->u, sizeof q->u);
    (void)memcpy(s->lam, q->lam, sizeof q->lam);
    (void)memcpy(s->mu_u, q->mu_u, sizeof q->mu_u);
    (void)memcpy(s->mult, q->mult, sizeof q->mult);
}

/* Departs from a saddle where no probe of the idle controls leads to a better plan, because the other variables would
 * have to follow. The idle controls move by `part` of their probe, the states stay, and the search continues; its
 * result is compared with the plan at the saddle. Returns 0 if the probe moves no control. */
static int depart(solver_t *s, real_t part)
{
    saddle_t *q = &s->saddle;
    keep_saddle(s);
    probe_plan(s);
    if (IDLE_STATES && !has_moved(s) && q->asked) {
        push_control(s, NU, (s->sqp.departures == 0) ? R(1) : -R(1));
    }
    const int moved = has_moved(s);
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t from = q->u[k][j];
            s->u[k][j] = from + part * (s->u[k][j] - from);
            s->u[k][j] = safe_value(s, k, j);
        }
    }
    if (AUGMENTED) {
        follow_augmented(s);
    }
    q->departed = DEPARTURE;
    s->sqp.entries = 0;
    s->sqp.most_violation = INF;
    return moved;
}

/* Ends a departure, at a solution or not. The plan at the saddle is restored if it is the better one. */
static void end_departure(solver_t *s, int solved)
{
    saddle_t *q = &s->saddle;
    q->departed = 0;
    if (solved && cost_of_plan(s) < q->cost - FACTOR_SADDLE_GAIN * FABS(q->cost)) {
        return;
    }
    return_to_saddle(s);
    evaluate_iterate(s);
    (void)kkt_is_within(s, R(1)); /* the saddle was solved */
    s->sqp.departures++;
}

/* Departs from a saddle, the second time by less. Samples have no time for that. */
static int departs(solver_t *s)
{
    if (ITERATES) {
        if (s->sqp.hasty) {
            return 0;
        }
    }
    if (s->sqp.departures >= DEPARTURES || !may_be_at_saddle(s)) {
        return 0;
    }
    if (!depart(s, (s->sqp.departures == 0) ? FACTOR_DEPARTURE : FACTOR_SECOND_DEPARTURE)) {
        end_departure(s, 0);
        return 0;
    }
    return 1;
}
#endif

/* State of the plan after an iteration: not yet a solution; a solution; moved away from a saddle. */
enum { GOES_ON, IS_SOLVED, HAS_LEFT };

static int look_for_saddle(solver_t *s, int solved)
{
    if (SOLVE) {
        if (s->saddle.departed > 0) {
            s->saddle.departed--;
            if (!solved && s->saddle.departed > 0) {
                return GOES_ON;
            }
            end_departure(s, solved);
            solved = 1;
        }
    }
    if (!solved) {
        return GOES_ON;
    }
    if (s->sqp.probes < MAX_ATTEMPTS && leave_saddle(s)) {
        s->sqp.probes++;
        return HAS_LEFT;
    }
    if (SOLVE && departs(s)) {
        return HAS_LEFT;
    }
    return IS_SOLVED;
}
