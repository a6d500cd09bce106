/* Functions of a package are called for many of its structs, and closed loops run in compiled code. Threads of the
 * caller share the work. Every struct is the caller's; nothing is kept between calls. */

/* begin declarations */
typedef void (*batch_function_t)(void); /* function of the package; its true type follows from the operation */

typedef enum {
    BATCH_COPY, /* the struct becomes a copy of first */
    BATCH_PLAIN, /* f(s) */
    BATCH_SAMPLE, /* f(s, first, out) */
    BATCH_SOLVE, /* f(s, first, number, place[0]) */
    BATCH_INTEGRATE, /* f(s, first, second, number, out) */
    BATCH_COST, /* out = f(s) */
    BATCH_SET, /* f(s, first) */
    BATCH_SET_NODE, /* f(s, place[0], first) */
    BATCH_SET_TWO, /* f(s, place[0], place[1], first) */
    BATCH_SET_THREE, /* f(s, place[0], place[1], place[2], first) */
    BATCH_SET_PAIR, /* f(s, place[0], place[1], first[0], second[0]) */
    BATCH_SET_PAIRS /* f(s, place[0], place[1], place[2], first, second) */
} batch_operation_t;

typedef struct { /* controllers that threads claim in chunks, first those of their own share, then others */
    int64_t count; /* number of controllers */
    int64_t chunk; /* number of controllers that are claimed at once */
    int32_t threads;
    int64_t *next; /* next[8 t]: first controller of share t that no thread has claimed */
} batch_work_t;

typedef struct { /* one call for all controllers */
    batch_work_t work;
    int32_t operation;
    batch_function_t function;
    char *memory; /* memory of the structs */
    int64_t stride; /* bytes from one struct to the next */
    const int64_t *index; /* indices of the structs; NULL: all of them */
    const void *first; /* inputs of the first controller */
    int64_t first_step; /* bytes to the inputs of the next controller; 0: all share them */
    const void *second;
    int64_t second_step;
    void *out; /* outputs of the first controller */
    int64_t out_step;
    int32_t *status; /* status of every controller */
    int32_t place[3];
    double number;
} batch_call_t;

/* Runs the share of thread number t in a call. */
void batch_run(const batch_call_t *call, int32_t t);

typedef struct { /* random numbers of a signal: standard normal, or uniform between -1 and 1, times size */
    const double *size; /* sizes of the elements; NULL: no signal */
    int32_t uniform;
    int32_t stream; /* number of the signal in the generator */
} batch_random_t;

typedef struct { /* values over the samples for one column of stored data */
    int32_t column;
    int64_t rows; /* number of rows; 1: they hold in all samples */
    int64_t flight_step; /* bytes from the table of a flight to that of the next one; 0: all flights share it */
    const void *values;
} batch_column_t;

typedef struct { /* data that one call of a setter sets before every sample */
    int32_t setter; /* batch_setter_t */
    batch_function_t set; /* setter of one row for all nodes or for node N */
    batch_function_t set_range; /* setter of a row for each node; NULL: all nodes share one row */
    int32_t number; /* number of the parameter, or of the row */
    int32_t nodes; /* rows of stored data */
    int32_t end; /* number of the last node */
    int32_t width; /* columns of the setter */
    int64_t offset; /* bytes from the struct to the first row */
    int64_t row_step; /* bytes from a stored row to the next one */
    const int64_t *ahead; /* samples from the present one to that of each row */
    int32_t count; /* number of columns */
    const batch_column_t *columns;
} batch_data_t;

typedef enum { BATCH_PARAMETER, BATCH_REFERENCE, BATCH_TERMINAL_REFERENCE, BATCH_BOUNDS } batch_setter_t;

typedef struct { /* structs of flights: one for each, or one for all */
    char *memory;
    int64_t stride; /* bytes from one struct to the next; 0: one for all flights */
    int64_t size; /* bytes of a struct */
    int64_t structs;
    int32_t count;
    const batch_data_t *data;
} batch_place_t;

typedef struct { /* closed loops: x_{k+1} = plant(x_k, u_k) + disturbance_k, u_k = step(x_k + noise_k) */
    int32_t nx;
    int32_t nu;
    batch_function_t step;
    batch_function_t integrate; /* integrate() of the plant */
    batch_function_t algebraic; /* algebraic() of the plant; NULL: there are no algebraic variables */
    batch_place_t controller; /* controllers: a flight changes its own, or a copy of the one for all */
    batch_place_t plant; /* plants: a flight changes a copy; memory NULL: the controller is its own plant */
    int32_t tells_all; /* 1: data that hold in all samples are set again before each of them */
    int32_t plant_is_true; /* 1: algebraic variables are those of the plant, else those of the controller */
    const volatile int32_t *stop; /* not 0: flights end before their next sample; NULL: never */
    int64_t known; /* bytes from a struct to the data of the previous sample, which are copied to separate plants */
    int64_t known_size; /* bytes of these data */
    int64_t steps;
    int64_t number; /* number of flight 0 in the generator */
    int32_t pieces; /* number of integrations of a sample */
    double dt; /* length of one integration */
    uint64_t seed;
    batch_random_t disturbance;
    batch_random_t noise;
    const double *given; /* (flights, steps, nx): further additions to the state; NULL: none */
    int64_t given_step; /* bytes from one flight to the next; 0: all flights share them */
    uint32_t failures; /* bit mask of the statuses that are failures */
    const double *x0; /* initial states (flights, nx) */
    double *x; /* states (until - from, steps + 1, nx), like all outputs */
    double *u; /* controls (steps, nu) of each */
    double *z; /* algebraic variables (steps, algebraic) of each */
    int32_t algebraic_count;
    int8_t *status; /* statuses (steps) of each */
    int64_t *failed; /* first sample that failed, or -1 */
    int64_t *lost; /* sample after which the state was not finite, or -1 */
    double *seconds; /* (2) of each: seconds of all calls of step, and of the longest one; NaN without a clock */
    char *copies; /* a struct of the controller, then one of the plant, each aligned */
    void *rows; /* largest number of rows and columns of any data */
} batch_flights_t;

/* Runs the flights from .. until - 1. Returns 0, the status of a setter that has refused data, or -1 if stopped. */
int32_t batch_fly(const batch_flights_t *f, int64_t from, int64_t until);

/* Runs sample k of a single flight on the structs themselves; arrays have one flight. xhat (nx): the state that the
 * controller receives. Returns the same as batch_fly. */
int32_t batch_fly_sample(const batch_flights_t *f, int64_t k, void *xhat);

/* Sets the data of sample k of that flight. */
int32_t batch_tell_sample(const batch_flights_t *f, int64_t k);

/* Draws the random numbers of a signal (count, n) of samples from .. from + count - 1 of a flight. */
void batch_draw(
    const batch_random_t *r, uint64_t seed, int64_t flight, int64_t from, int64_t count, int32_t n, double *out);
/* end declarations */
