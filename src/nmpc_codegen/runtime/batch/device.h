/* Operations of a launch, in which each thread serves one controller. */

/* begin declarations */
typedef enum {
    BATCH_ON_COPY, /* the struct becomes a copy of struct 0 of first */
    BATCH_ON_STEP,
    BATCH_ON_PREPARE,
    BATCH_ON_FEEDBACK,
    BATCH_ON_SOLVE,
    BATCH_ON_SHIFT,
    BATCH_ON_RESET,
    BATCH_ON_INTEGRATE,
    BATCH_ON_COST,
    BATCH_ON_FLY /* the flights from .. from + threads - 1 */
} batch_on_t;

typedef struct { /* the arguments of one launch */
    int64_t threads; /* number of controllers that are called, or of flights */
    int64_t structs;
    uint32_t *words; /* word w of struct i is words[w * structs + i] */
    const int64_t *index; /* (threads): numbers of the structs; NULL: all in order */
    int32_t operation; /* batch_on_t */
    int32_t count; /* most iterations of solve */
    double number;
    const void *first; /* (threads, nx): states */
    const void *second; /* (threads, nu): controls */
    void *out; /* (threads, nu or nx or 1) */
    int32_t *status; /* (threads) */
    int64_t from; /* first flight of the launch */
    batch_flights_t flights; /* memory of a plant: its words, interleaved */
} batch_launch_t;
/* end declarations */
