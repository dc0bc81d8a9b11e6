// Reconstructs a frame of particles in memory, and writes a mesh file: `frame OUTPUT`.
#include <meniscus.h>

#include <stdio.h>

struct particle {
  float mass, position[3], velocity[3];
};

static int32_t print_progress(void *user, const MeniscusProgress *progress) {
  fprintf(user, "%s %3.0f %%\n", progress->name, 100 * progress->done);
  return 0;  // Any other value cancels the work.
}

int main(int count, char **arguments) {
  enum { SIDE = 20, COUNT = SIDE * SIDE * SIDE };
  static struct particle water[COUNT];
  for (int i = 0; i < COUNT; i++) {
    const int at[3] = {i % SIDE, i / SIDE % SIDE, i / SIDE / SIDE};
    for (int axis = 0; axis < 3; axis++) water[i].position[axis] = 0.05f * (float)at[axis];
    water[i].velocity[1] = -9.81f * 0.05f;
  }
  // The library reads the arrays in place, without a copy.
  const MeniscusAttribute velocity = {
      .size = sizeof velocity, .name = "velocity", .values = water[0].velocity, .components = 3, .stride = sizeof *water};
  const MeniscusParticles particles = {.size = sizeof particles,
                                       .count = COUNT,
                                       .positions = water[0].position,
                                       .stride = sizeof *water,
                                       .attributes = &velocity,
                                       .attribute_count = 1};
  MeniscusOptions *options = meniscus_options_new();
  MeniscusMesh *mesh = NULL;
  MeniscusStatus status = meniscus_options_set_number(options, "spacing", 0.05);
  if (status == MENISCUS_STATUS_OK) status = meniscus_options_set(options, "normals", "true");
  if (status == MENISCUS_STATUS_OK) status = meniscus_options_on_progress(options, print_progress, stderr);
  if (status == MENISCUS_STATUS_OK) status = meniscus_reconstruct(&particles, options, &mesh);
  if (status == MENISCUS_STATUS_OK) status = meniscus_mesh_write(mesh, count > 1 ? arguments[1] : "water.ply", 1, NULL);
  if (status != MENISCUS_STATUS_OK) {
    fprintf(stderr, "%s\n", meniscus_last_error());
  } else {
    printf("%llu triangles\n", (unsigned long long)meniscus_mesh_triangle_count(mesh));
  }
  meniscus_mesh_free(mesh);
  meniscus_options_free(options);
  return status;
}
