/* Round trips over Cyclone DDS, as `vlaps bench ipc` makes them over shared memory.
 *
 * latency MESSAGE spin|bell PERIOD_NS WARM COUNT CORE_PING CORE_ECHO
 *
 * Forks the answering process and prints half of each counted round trip, ns, one per
 * line. A negative core means no pinning. Both ends read from a queue of one message,
 * best effort, volatile: the stack's `latest value wins` in terms of DDS.
 */
#define _GNU_SOURCE
#include <sched.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "block.h"
#include "dds/dds.h"

/* A message counts as lost after this time. */
#define LOST_NS 5000000000LL

static void fail(const char *what, dds_return_t code) {
  fprintf(stderr, "latency: %s: %s\n", what, dds_strretcode(code));
  exit(1);
}

static dds_entity_t made(const char *what, dds_entity_t entity) {
  if (entity < 0) fail(what, entity);
  return entity;
}

static int64_t now_ns(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1000000000LL + now.tv_nsec;
}

static void sleep_until(int64_t instant_ns) {
  struct timespec until = {instant_ns / 1000000000, instant_ns % 1000000000};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL) != 0) {
  }
}

static void stay_on(int core) {
  if (core < 0) return;
  cpu_set_t cores;
  CPU_ZERO(&cores);
  CPU_SET(core, &cores);
  sched_setaffinity(0, sizeof cores, &cores);
}

static const dds_topic_descriptor_t *descriptor(const char *message) {
  if (!strcmp(message, "command")) return &vlaps_Command_desc;
  if (!strcmp(message, "advice")) return &vlaps_Advice_desc;
  if (!strcmp(message, "plan")) return &vlaps_Plan_desc;
  if (!strcmp(message, "observation")) return &vlaps_Observation_desc;
  if (!strcmp(message, "step")) return &vlaps_Step_desc;
  fprintf(stderr, "latency: no message %s\n", message);
  exit(2);
}

struct end {
  dds_entity_t writer, reader, waitset;
  int sleeps;
};

static struct end open_end(const char *message, int sleeps, int is_ping) {
  dds_entity_t domain = made("participant", dds_create_participant(0, NULL, NULL));
  dds_qos_t *qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_BEST_EFFORT, 0);
  dds_qset_durability(qos, DDS_DURABILITY_VOLATILE);
  dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 1);
  dds_entity_t topics[2];
  const char *names[2] = {"vlaps_there", "vlaps_back"};
  for (int k = 0; k < 2; k++) {
    char name[64];
    snprintf(name, sizeof name, "%s_%s", names[k], message);
    topics[k] = made("topic", dds_create_topic(domain, descriptor(message), name, NULL, NULL));
  }
  struct end end;
  end.sleeps = sleeps;
  end.writer = made("writer", dds_create_writer(domain, topics[is_ping ? 0 : 1], qos, NULL));
  end.reader = made("reader", dds_create_reader(domain, topics[is_ping ? 1 : 0], qos, NULL));
  end.waitset = made("waitset", dds_create_waitset(domain));
  dds_set_status_mask(end.reader, DDS_DATA_AVAILABLE_STATUS);
  dds_return_t attached = dds_waitset_attach(end.waitset, end.reader, 0);
  if (attached < 0) fail("waitset", attached);
  dds_delete_qos(qos);
  return end;
}

static void await_peer(struct end *end) {
  int64_t until = now_ns() + 4 * LOST_NS;
  dds_publication_matched_status_t written;
  dds_subscription_matched_status_t read;
  do {
    dds_sleepfor(DDS_MSECS(10));
    dds_get_publication_matched_status(end->writer, &written);
    dds_get_subscription_matched_status(end->reader, &read);
    if (now_ns() > until) {
      fprintf(stderr, "latency: the two participants do not find each other\n");
      exit(1);
    }
  } while (written.current_count < 1 || read.current_count < 1);
}

static void await_message(struct end *end, void *message) {
  int64_t until = now_ns() + LOST_NS;
  void *samples[1] = {message};
  dds_sample_info_t info[1];
  for (unsigned looks = 1;; looks++) {
    dds_return_t taken = dds_take(end->reader, samples, info, 1, 1);
    if (taken < 0) fail("take", taken);
    if (taken == 1 && info[0].valid_data) return;
    if (end->sleeps) dds_waitset_wait(end->waitset, NULL, 0, DDS_MSECS(500));
    if ((end->sleeps || looks % 4096 == 0) && now_ns() > until) {
      fprintf(stderr, "latency: a message did not come within 5 s\n");
      exit(1);
    }
  }
}

static void send(struct end *end, const void *message) {
  dds_return_t written = dds_write(end->writer, message);
  if (written < 0) fail("write", written);
}

int main(int count, char **words) {
  if (count != 8) {
    fprintf(stderr, "latency MESSAGE spin|bell PERIOD_NS WARM COUNT CORE_PING CORE_ECHO\n");
    return 2;
  }
  const char *message = words[1];
  int sleeps = !strcmp(words[2], "bell");
  int64_t period_ns = atoll(words[3]);
  long warm = atol(words[4]), counted = atol(words[5]);
  void *bytes = calloc(1, 8192);
  int64_t *half_ns = calloc((size_t)counted + 1, sizeof *half_ns);
  if (!bytes || !half_ns) return 1;
  pid_t child = fork();
  if (child == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    stay_on(atoi(words[7]));
    struct end end = open_end(message, sleeps, 0);
    await_peer(&end);
    for (long k = 0; k < warm + counted; k++) {
      await_message(&end, bytes);
      send(&end, bytes);
    }
    // Wait until the last answer has been sent.
    dds_sleepfor(DDS_MSECS(200));
    return 0;
  }
  stay_on(atoi(words[6]));
  struct end end = open_end(message, sleeps, 1);
  await_peer(&end);
  // The other participant may not have discovered this one yet.
  dds_sleepfor(DDS_MSECS(300));
  int64_t begun = now_ns();
  for (long k = 0; k < warm + counted; k++) {
    if (period_ns > 0) sleep_until(begun + k * period_ns);
    int64_t sent = now_ns();
    send(&end, bytes);
    await_message(&end, bytes);
    if (k >= warm) half_ns[k - warm] = (now_ns() - sent) / 2;
  }
  int status = 0;
  waitpid(child, &status, 0);
  for (long k = 0; k < counted; k++) printf("%lld\n", (long long)half_ns[k]);
  return status != 0;
}
