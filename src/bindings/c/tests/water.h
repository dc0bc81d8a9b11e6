// Shared by all tests: water of about 1000 particles, and macros that check a condition.
#ifndef WATER_H
#define WATER_H

#include <meniscus.h>

#include <dirent.h>
#include <math.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define CHECK(what)                                                                                            \
  do {                                                                                                         \
    if (!(what)) {                                                                                             \
      fprintf(stderr, "%s:%d: %s\n  last error: %s\n", __FILE__, __LINE__, #what, meniscus_last_error());      \
      exit(1);                                                                                                 \
    }                                                                                                          \
  } while (0)

#define OK(call) CHECK((call) == MENISCUS_STATUS_OK)

/// A pseudo-random number from 0 to 1; the sequence is the same on every machine.
static inline double next(uint64_t *state) {
  *state = *state * 6364136223846793005u + 1442695040888963407u;
  return (double)(*state >> 40) / (double)(1 << 24);
}

enum { SIDE = 10, DROPS = 5, COUNT = SIDE * SIDE * SIDE + DROPS };

#define SPACING 0.05

/// A cube of water with `side` particles along each edge, slightly disordered and moved up by `shift`. Coordinates are of type float.
static inline void pour_cube(float (*positions)[3], int side, float shift) {
  uint64_t state = 7;
  for (int i = 0; i < side * side * side; i++) {
    const int at[3] = {i % side, i / side % side, i / side / side};
    for (int axis = 0; axis < 3; axis++) {
      double jitter = 0.4 * (next(&state) - 0.5);
      positions[i][axis] = (float)((at[axis] + jitter) * SPACING) + (axis == 1 ? shift : 0);
    }
  }
}

/// Water of COUNT particles: a cube, and drops above it.
static inline void pour(float positions[COUNT][3], float shift) {
  pour_cube(positions, SIDE, shift);
  for (int drop = 0; drop < DROPS; drop++) {
    float *at = positions[COUNT - DROPS + drop];
    at[0] = at[2] = (float)(2 * drop * SPACING), at[1] = (float)((SIDE + 6) * SPACING) + shift;
  }
}

/// Creates options from alternating keys and values; the caller frees them.
#define OPTIONS(...) options_of((const char *const[]){__VA_ARGS__, NULL})

static inline MeniscusOptions *options_of(const char *const *pairs) {
  MeniscusOptions *options = meniscus_options_new();
  for (; *pairs; pairs += 2) {
    OK(meniscus_options_set(options, pairs[0], pairs[1]));
  }
  return options;
}

static inline MeniscusParticles particles_of(float positions[COUNT][3]) {
  MeniscusParticles particles = {.size = sizeof particles, .count = COUNT, .positions = positions};
  return particles;
}

/// Waits until all threads of the library have ended, and fails if they take more than 10 s.
static inline void wait_for_threads(void) {
  for (int tries = 0;; tries++) {
    int threads = 0;
    DIR *tasks = opendir("/proc/self/task");
    for (struct dirent *task; tasks && (task = readdir(tasks));) {
      threads += *task->d_name != '.';
    }
    CHECK(tasks && closedir(tasks) == 0);
    if (threads == 1) {
      return;
    }
    CHECK(tries < 1000);
    usleep(10000);
  }
}

#ifndef FUZZED
/// The test that the including file defines; `main` calls it.
static int test(int count, char **arguments);

/// Whether a graphics driver was used. The threads of a driver keep running after a call, so `main`
/// then does not wait until all threads have ended.
static bool driver_used;

static struct { int count; char **arguments; int code; } test_call;

static inline void *run_test(void *unused) {
  test_call.code = test(test_call.count, test_call.arguments);
  return unused;
}

/// Runs the test on a separate thread. When this thread ends, the library must free the data that
/// belongs to this thread. Valgrind reports data that the library does not free.
int main(int count, char **arguments) {
  pthread_t thread;
  test_call.count = count, test_call.arguments = arguments;
  CHECK(pthread_create(&thread, NULL, run_test, NULL) == 0 && pthread_join(thread, NULL) == 0);
  if (!driver_used) {
    wait_for_threads();
  }
  return test_call.code;
}
#endif

#endif
