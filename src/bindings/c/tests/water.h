// What all tests need: water of a few hundred particles, and sentences that must be true.
#ifndef WATER_H
#define WATER_H

#include <meniscus.h>

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CHECK(what)                                                                                            \
  do {                                                                                                         \
    if (!(what)) {                                                                                             \
      fprintf(stderr, "%s:%d: %s\n  last error: %s\n", __FILE__, __LINE__, #what, meniscus_last_error());      \
      exit(1);                                                                                                 \
    }                                                                                                          \
  } while (0)

#define OK(call) CHECK((call) == MENISCUS_STATUS_OK)

/// A number from 0 to 1, the same on every machine.
static inline double next(uint64_t *state) {
  *state = *state * 6364136223846793005u + 1442695040888963407u;
  return (double)(*state >> 40) / (double)(1 << 24);
}

enum { SIDE = 10, DROPS = 5, COUNT = SIDE * SIDE * SIDE + DROPS };

#define SPACING 0.05

/// A block of water in some disorder, moved by `shift`, and drops above it. Coordinates are numbers of 32 bits.
static inline void pour(float positions[COUNT][3], float shift) {
  uint64_t state = 7;
  for (int i = 0; i < COUNT; i++) {
    int at[3] = {i % SIDE, i / SIDE % SIDE, i / SIDE / SIDE};
    if (i >= COUNT - DROPS) {
      at[0] = at[2] = 2 * (i - COUNT + DROPS), at[1] = SIDE + 6;
    }
    for (int axis = 0; axis < 3; axis++) {
      double jitter = 0.4 * (next(&state) - 0.5);
      positions[i][axis] = (float)((at[axis] + jitter) * SPACING) + (axis == 1 ? shift : 0);
    }
  }
}

static inline MeniscusParticles particles_of(float positions[COUNT][3]) {
  MeniscusParticles particles = {.size = sizeof particles, .count = COUNT, .positions = positions};
  return particles;
}

#endif
