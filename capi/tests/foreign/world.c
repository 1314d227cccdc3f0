/* A world whose wrong answers are refused, and whose times are the library's. */
#include <stdio.h>
#include <string.h>

#include "vlaps.h"

static int failures = 0;

static void expect(const char *call, int got, int wanted, const char *said) {
    if (got == wanted && (got >= 0 || strstr(vlaps_last_error(), said))) return;
    printf("%s: %d, not %d with '%s': %s\n", call, got, wanted, said, vlaps_last_error());
    failures++;
}
#define EXPECT(call, wanted, said) expect(#call, call, wanted, said)

int main(int argc, char **argv) {
    static vlaps_observation seen;
    vlaps_progress progress;
    vlaps_tick tick;
    memset(&progress, 0, sizeof progress);
    seen.lidar_max_m = 50;
    seen.field_of_view_rad = 1;
    seen.beam_count = 60;
    for (uint32_t k = 0; k < seen.beam_count; k++) seen.ranges_m[k] = seen.lidar_max_m;
    EXPECT(vlaps_join("world", argc, argv), VLAPS_OK, "");
    const int episodes = vlaps_open("episode", VLAPS_WRITE);
    EXPECT(vlaps_await_tick(&tick), VLAPS_INVALID, "the loop publishes episode");
    EXPECT(vlaps_close(episodes), VLAPS_OK, "");
    EXPECT(vlaps_await_tick(&tick), VLAPS_OK, "");
    EXPECT(vlaps_open("progress", VLAPS_WRITE), VLAPS_INVALID, "publishes progress already");
    EXPECT(tick.begins, 1, "");
    progress.outcome = VLAPS_OUTCOME_ARRIVED;
    EXPECT(vlaps_finish_tick(&seen, &progress), VLAPS_INVALID, "outcome = arrived at the tick that begins");
    progress.outcome = VLAPS_OUTCOME_DRIVING;
    for (int k = 0; k < 8; k++) {
        seen.published_ns = 77;
        EXPECT(vlaps_finish_tick(&seen, &progress), VLAPS_OK, "");
        EXPECT(vlaps_await_tick(&tick), VLAPS_OK, "");
    }
    progress.outcome = VLAPS_OUTCOME_ARRIVED;
    EXPECT(vlaps_finish_tick(&seen, &progress), VLAPS_OK, "");
    EXPECT(vlaps_leave(), VLAPS_OK, "");
    printf("%d failures\n", failures);
    return failures == 0 ? 0 : 1;
}
