/* Wrong calls and values: each is refused with its reason, and the process lives on. */
#include <inttypes.h>
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "vlaps.h"

static int failures = 0;

static void expect(const char *call, int64_t got, int64_t wanted, const char *said) {
    const char *error = vlaps_last_error(), *none = NULL;
    if (got != wanted || !strstr(error, said) || strchr(error, '\n')) {
        printf("%s: %" PRId64 ", not %" PRId64 " with '%s': %s\n", call, got, wanted, said, error);
        failures++;
    }
    // Another error takes its place, so that the next call has to write its own.
    vlaps_join_as(VLAPS_LAYOUT, "cleared", 0, &none);
}
#define EXPECT(call, wanted, said) expect(#call, call, wanted, said)

static void *elsewhere(void *unused) {
    EXPECT(vlaps_wait(0), VLAPS_INVALID, "this thread has not joined a run");
    return unused;
}

static void before_joining(int argc, char **argv) {
    const char *const *words = (const char *const *)argv;
    char hashes[2][17];
    snprintf(hashes[0], 17, "%016" PRIx64, (uint64_t)VLAPS_LAYOUT ^ 1);
    snprintf(hashes[1], 17, "%016" PRIx64, (uint64_t)VLAPS_LAYOUT);
    EXPECT(vlaps_wait(0), VLAPS_INVALID, "vlaps_join comes first");
    EXPECT(vlaps_open("plan", VLAPS_WRITE), VLAPS_INVALID, "vlaps_join comes first");
    EXPECT((int64_t)vlaps_now_ns(), 0, "");
    for (int k = 0; k < 2; k++)
        EXPECT(vlaps_join_as(VLAPS_LAYOUT ^ 1, "planner", argc, words), VLAPS_OTHER_LAYOUT, hashes[k]);
    EXPECT(vlaps_join(NULL, argc, argv), VLAPS_INVALID, "process is NULL");
    EXPECT(vlaps_join("pilot", argc, argv), VLAPS_INVALID, "no process 'pilot'");
    EXPECT(vlaps_join("supervisor", argc, argv), VLAPS_INVALID, "no process 'supervisor'");
    EXPECT(vlaps_join("pl\xff", argc, argv), VLAPS_INVALID, "not UTF-8");
    EXPECT(vlaps_join("planner", argc, NULL), VLAPS_INVALID, "argv is NULL");
    EXPECT(vlaps_join("planner", -1, argv), VLAPS_INVALID, "argc = -1");
    EXPECT(vlaps_join("planner", 1, argv), VLAPS_INVALID, "--config");
}

static void ports(void) {
    EXPECT(vlaps_open(NULL, VLAPS_WRITE), VLAPS_INVALID, "service is NULL");
    EXPECT(vlaps_open("nothing", VLAPS_WRITE), VLAPS_INVALID, "no service 'nothing'");
    EXPECT(vlaps_open("no\x1b[2J\n", VLAPS_WRITE), VLAPS_INVALID, "no service 'no\\u{1b}[2J\\u{a}'");
    EXPECT(vlaps_open("observation", VLAPS_EVERY), VLAPS_INVALID, "observation has no queue");
    EXPECT(vlaps_open("command", VLAPS_WRITE), VLAPS_INVALID, "does not say that the planner publishes");
    EXPECT(vlaps_open("step", VLAPS_NEWEST), VLAPS_INVALID, "does not say that the planner reads");
    EXPECT(vlaps_open("health/planner", VLAPS_WRITE), VLAPS_INVALID, "no port of its own");
    EXPECT(vlaps_open("plan", 9), VLAPS_INVALID, "use = 9");
    const int writer = vlaps_open("plan", VLAPS_WRITE), reader = vlaps_open("observation", VLAPS_NEWEST);
    vlaps_plan plan;
    vlaps_observation seen;
    EXPECT(vlaps_newest(reader, &seen, sizeof seen), VLAPS_NONE, "");
    EXPECT(vlaps_newest(reader, NULL, sizeof seen), VLAPS_INVALID, "NULL");
    EXPECT(vlaps_newest(reader, &seen, sizeof seen - 1), VLAPS_INVALID, "bytes given, a message has");
    EXPECT(vlaps_newest(writer, &plan, sizeof plan), VLAPS_INVALID, "publishes plan");
    EXPECT(vlaps_publish(reader, &seen, sizeof seen), VLAPS_INVALID, "reads observation");
    EXPECT(vlaps_publish(writer, NULL, sizeof plan), VLAPS_INVALID, "NULL");
    EXPECT(vlaps_publish(-1, &plan, sizeof plan), VLAPS_INVALID, "port -1 is not open");
    EXPECT(vlaps_publish(99, &plan, sizeof plan), VLAPS_INVALID, "port 99 is not open");
    EXPECT(vlaps_close(reader), VLAPS_OK, "");
    EXPECT(vlaps_close(reader), VLAPS_INVALID, "is not open");
    EXPECT(vlaps_open("plan", VLAPS_WRITE), VLAPS_INVALID, "publishes plan already");
    EXPECT(vlaps_close(writer), VLAPS_OK, "");
}

/* The membership is that of the parent, which goes on. */
static void forked(void) {
    fflush(stdout);
    const pid_t child = fork();
    if (child == 0) {
        const int before = failures;
        const char *said = "a forked process has not joined";
        EXPECT(vlaps_wait(0), VLAPS_INVALID, said);
        EXPECT(vlaps_open("observation", VLAPS_NEWEST), VLAPS_INVALID, said);
        EXPECT(vlaps_pid_of("planner"), VLAPS_INVALID, said);
        EXPECT((int64_t)vlaps_now_ns(), 0, said);
        EXPECT(vlaps_leave(), VLAPS_INVALID, said);
        fflush(stdout);
        _exit(failures == before ? 0 : 1);
    }
    int status = -1;
    waitpid(child, &status, 0);
    if (status != 0) failures++;
    EXPECT(vlaps_wait(0), VLAPS_OK, "");
}

/* The library answers when the thread-locals of the main thread are gone, too. */
static void at_exit(void) {
    const int before = failures;
    EXPECT(vlaps_wait(0), VLAPS_INVALID, "comes first");
    fflush(stdout);
    if (failures != before) _exit(3);
}

/* Taken now: a message of before may be too old, because any call may take long. */
static vlaps_plan fresh(vlaps_plan plan) {
    plan.header.taken_ns = vlaps_now_ns();
    return plan;
}

static void values(void) {
    const int writer = vlaps_open("plan", VLAPS_WRITE);
    vlaps_plan plan, wrong;
    memset(&plan, 0, sizeof plan);
    EXPECT(vlaps_publish(writer, &plan, sizeof plan), VLAPS_REFUSED, "over the limit");
    // A minute ahead.
    plan.header.taken_ns = vlaps_now_ns() + UINT64_C(60000000000);
    EXPECT(vlaps_publish(writer, &plan, sizeof plan), VLAPS_REFUSED, "in the future");
    EXPECT((plan = fresh(plan), vlaps_publish(writer, &plan, sizeof plan)), VLAPS_OK, "");
    EXPECT((plan = fresh(plan), vlaps_publish(writer, &plan, sizeof plan - 8)),
           VLAPS_INVALID, "2160 bytes given");
    EXPECT((wrong = fresh(plan), wrong.cost_m = NAN, vlaps_publish(writer, &wrong, sizeof wrong)),
           VLAPS_REFUSED, "plan: cost_m is not finite");
    EXPECT((wrong = fresh(plan), wrong.waypoint_count = 65,
            vlaps_publish(writer, &wrong, sizeof wrong)),
           VLAPS_REFUSED, "waypoint_count = 65 is over the capacity of 64");
    EXPECT((wrong = fresh(plan), wrong.outcome = 77, vlaps_publish(writer, &wrong, sizeof wrong)),
           VLAPS_REFUSED, "outcome has the unknown code 77");
    vlaps_observation seen;
    memset(&seen, 0, sizeof seen);
    seen.header.taken_ns = vlaps_now_ns();
    seen.ego.speed_mps = NAN;
    EXPECT(vlaps_admit("observation", &seen, sizeof seen), VLAPS_REFUSED, "ego.speed_mps is not finite");
    EXPECT(vlaps_admit("nothing", &seen, sizeof seen), VLAPS_INVALID, "no service");
}

static void loops(void) {
    vlaps_tick tick;
    vlaps_plan plan;
    vlaps_progress progress;
    vlaps_observation seen;
    double number = 0, directions_rad[240];
    memset(&plan, 0, sizeof plan);
    memset(&progress, 0, sizeof progress);
    memset(&seen, 0, sizeof seen);
    EXPECT(vlaps_answer(&plan), VLAPS_INVALID, "comes first");
    EXPECT(vlaps_await_observation(&seen), VLAPS_INVALID, "the loop publishes plan");
    EXPECT(vlaps_await_tick(&tick), VLAPS_INVALID, "joined as the planner");
    EXPECT(vlaps_await_tick(NULL), VLAPS_INVALID, "NULL");
    EXPECT(vlaps_finish_tick(&seen, &progress), VLAPS_INVALID, "comes first");
    EXPECT(vlaps_setting("scanner.beams", &number), VLAPS_OK, "");
    EXPECT((int64_t)number, 240, "");
    EXPECT(vlaps_setting("scanner.beams", NULL), VLAPS_INVALID, "NULL");
    EXPECT(vlaps_setting("run.name", &number), VLAPS_INVALID, "is no number");
    EXPECT(vlaps_setting("run.speed", &number), VLAPS_INVALID, "no key 'run.speed'");
    EXPECT(vlaps_beams(&seen, directions_rad, 240), VLAPS_OK, "");
    EXPECT((int64_t)seen.beam_count, 240, "");
    EXPECT((int64_t)(directions_rad[60] * 180 / 3.14159265358979), 90, "");
    EXPECT(vlaps_beams(&seen, directions_rad, 239), VLAPS_INVALID, "room for 239");
    EXPECT(vlaps_beams(&seen, NULL, 240), VLAPS_INVALID, "NULL");
    EXPECT(vlaps_beams(NULL, directions_rad, 240), VLAPS_INVALID, "NULL");
    EXPECT(vlaps_pid_of("planner"), getpid(), "");
    EXPECT(vlaps_pid_of("pilot"), VLAPS_INVALID, "no process 'pilot'");
}

int main(int argc, char **argv) {
    pthread_t thread;
    atexit(at_exit);
    before_joining(argc, argv);
    EXPECT(vlaps_join("planner", argc, argv), VLAPS_OK, "");
    EXPECT(vlaps_join("planner", argc, argv), VLAPS_INVALID, "only once");
    ports();
    values();
    loops();
    forked();
    EXPECT(pthread_create(&thread, NULL, elsewhere, NULL), 0, "");
    EXPECT(pthread_join(thread, NULL), 0, "");
    EXPECT(vlaps_wait(1000), VLAPS_OK, "");
    EXPECT(vlaps_leave(), VLAPS_OK, "");
    EXPECT(vlaps_leave(), VLAPS_OK, "");
    EXPECT(vlaps_wait(0), VLAPS_INVALID, "comes first");
    printf("%d failures\n", failures);
    return failures == 0 ? 0 : 1;
}
