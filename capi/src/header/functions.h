
/* Why the last call of this thread failed: one line, valid until the next call. */
const char *vlaps_last_error(void);

/* The layout hash of the library. */
uint64_t vlaps_layout(void);

/* All messages, lists and services as JSON, for bindings of other languages. */
const char *vlaps_describe(void);

/* Joins the run as "world", "planner", "controller", "gate", "learner" or "recorder".
 * The arguments are those with which the supervisor started this program. Call it first
 * in main; from then on SIGTERM and SIGINT are a request to stop, and the process ends
 * with its supervisor. */
int vlaps_join_as(uint64_t layout, const char *process, int argc, const char *const *argv);

static inline int vlaps_join(const char *process, int argc, char **argv) {
    return vlaps_join_as(VLAPS_LAYOUT, process, argc, (const char *const *)argv);
}

/* Leaves the run. Without it the supervisor removes what the process held. */
int vlaps_leave(void);

/* Opens a port of a service: VLAPS_NEWEST, VLAPS_EVERY or VLAPS_WRITE. Returns its
 * number. The service's row has to name the process for this use. */
int vlaps_open(const char *service, uint32_t use);
int vlaps_close(int port);

/* Copies the newest message, or the next one of a queue, that passed its check.
 * VLAPS_OK when there was one, else VLAPS_NONE. */
int vlaps_newest(int port, void *message, size_t bytes);
int vlaps_next(int port, void *message, size_t bytes);

/* Checks a message and sends it. VLAPS_REFUSED when the check fails: vlaps_last_error
 * names the field, and nothing is sent. */
int vlaps_publish(int port, const void *message, size_t bytes);

/* The check alone. */
int vlaps_admit(const char *service, const void *message, size_t bytes);

/* Sleeps until a message wakes this process, at most limit_ns and 20 ms; publishes
 * health and timing, and connects to new peers. VLAPS_ENDED when the process has to
 * exit. Call it at least once in a second. */
int vlaps_wait(uint64_t limit_ns);

/* The process id of a process of the run; 0 while the roster names none. */
int64_t vlaps_pid_of(const char *process);

/* The machine's monotonic clock, ns; 0 before the process has joined. */
uint64_t vlaps_now_ns(void);

/* 1 in lockstep, where the run's clock is simulated, else 0. */
int vlaps_is_lockstep(void);

/* A number of the run's configuration, such as "scanner.range_m"; true is 1. */
int vlaps_setting(const char *key, double *number);

/* For a world: writes the section [scanner] of the run into an observation (lidar_max_m,
 * beam_count, field_of_view_rad and the place of the scanner), and where each beam looks
 * into an array with room for `count` directions, rad counter-clockwise from the heading
 * of the body; VLAPS_BEAMS_MAX is always enough. The beams begin at scanner_x_body_m,
 * scanner_y_body_m. */
int vlaps_beams(vlaps_observation *observation, double *directions_rad, size_t count);

/* The loop of a world: its grid, the age limit of commands, the brake, the episodes.
 * vlaps_await_tick waits for the next instant; VLAPS_ENDED: exit with 0. The answer to
 * each is vlaps_finish_tick; headers, instants and counts are filled in. An outcome of
 * the progress other than VLAPS_OUTCOME_DRIVING ends the episode. */
int vlaps_await_tick(vlaps_tick *tick);
int vlaps_finish_tick(const vlaps_observation *observation, const vlaps_progress *progress);

/* The loop of a planner: waits for the next observation of a planner's turn;
 * VLAPS_ENDED: exit with 0. The answer to each is vlaps_answer; header, origin and times
 * are filled in. */
int vlaps_await_observation(vlaps_observation *observation);
int vlaps_answer(const vlaps_plan *plan);

#ifdef __cplusplus
}
#endif

#endif
