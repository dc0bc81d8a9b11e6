// Tests the guarantees of the interface: `behaviour FOLDER`. One guarantee has a separate test:
// same_bytes.c checks that the library writes the same bytes as the program.
#include "water.h"

static float positions[COUNT][3];

/// Copies with 32-bit and 64-bit numbers contain the same mesh as the arrays in the library's memory.
static void copies_equal_arrays(void) {
  static float velocity[COUNT][3], heat[COUNT];
  for (int i = 0; i < COUNT; i++) {
    velocity[i][2] = 3, heat[i] = (float)i;
  }
  const MeniscusAttribute attributes[] = {
      {.size = sizeof *attributes, .name = "vel", .values = velocity, .components = 3},
      {.size = sizeof *attributes, .name = "heat", .values = heat, .components = 1},
  };
  MeniscusParticles particles = particles_of(positions);
  particles.attributes = attributes, particles.attribute_count = 2;
  MeniscusOptions *options =
      OPTIONS("spacing", "0.05", "normals", "true", "attributes", "velocity,heat");
  MeniscusMesh *mesh;
  OK(meniscus_reconstruct(&particles, options, &mesh));
  meniscus_options_free(options);
  MeniscusArrays arrays = {.size = sizeof arrays};
  OK(meniscus_mesh_arrays(mesh, &arrays));
  const uint64_t vertices = meniscus_mesh_vertex_count(mesh), triangles = meniscus_mesh_triangle_count(mesh);
  CHECK(vertices > 1000 && arrays.vertex_count == vertices && arrays.triangle_count == triangles);
  double *wide = malloc(3 * vertices * sizeof *wide);
  float *narrow = malloc(3 * vertices * sizeof *narrow), *values = malloc(3 * vertices * sizeof *values);
  uint32_t *corners = malloc(3 * triangles * sizeof *corners);
  uint64_t *wide_corners = malloc(3 * triangles * sizeof *wide_corners);
  OK(meniscus_mesh_positions_f64(mesh, wide, 3 * vertices));
  OK(meniscus_mesh_positions_f32(mesh, narrow, 3 * vertices));
  OK(meniscus_mesh_triangles_u32(mesh, corners, 3 * triangles));
  OK(meniscus_mesh_triangles_u64(mesh, wide_corners, 3 * triangles));
  CHECK(memcmp(wide, arrays.positions, 3 * vertices * sizeof *wide) == 0);
  CHECK(memcmp(corners, arrays.triangles, 3 * triangles * sizeof *corners) == 0);
  for (uint64_t i = 0; i < 3 * vertices; i++) {
    CHECK(narrow[i] == (float)wide[i]);
  }
  for (uint64_t i = 0; i < 3 * triangles; i++) {
    CHECK(wide_corners[i] == corners[i] && corners[i] < vertices);
  }
  CHECK(meniscus_mesh_has_normals(mesh) == 1);
  OK(meniscus_mesh_normals(mesh, values, 3 * vertices));
  CHECK(memcmp(values, arrays.normals, 3 * vertices * sizeof *values) == 0);
  CHECK(fabsf(hypotf(hypotf(values[0], values[1]), values[2]) - 1) < 1e-5f);
  CHECK(meniscus_mesh_attribute_count(mesh) == 2 && arrays.attribute_count == 2);
  CHECK(strcmp(meniscus_mesh_attribute_name(mesh, 0), "velocity") == 0 && meniscus_mesh_attribute_components(mesh, 0) == 3);
  CHECK(strcmp(arrays.attributes[1].name, "heat") == 0 && arrays.attributes[1].components == 1);
  OK(meniscus_mesh_attribute(mesh, 0, values, 3 * vertices));
  CHECK(values[0] == 0 && fabsf(values[2] - 3) < 1e-6f && values[2] == arrays.attributes[0].values[2]);
  OK(meniscus_mesh_attribute(mesh, 1, values, vertices));
  CHECK(values[vertices / 2] > 1 && values[vertices / 2] < COUNT);
  CHECK(meniscus_mesh_attribute_name(mesh, 2) == NULL && meniscus_mesh_attribute_components(mesh, 2) == 0);
  CHECK(meniscus_mesh_attribute(mesh, 2, values, vertices) == MENISCUS_STATUS_REQUEST);
  // A buffer that is too small stays unchanged.
  narrow[0] = 77;
  CHECK(meniscus_mesh_positions_f32(mesh, narrow, 3 * vertices - 1) == MENISCUS_STATUS_REQUEST && narrow[0] == 77);
  CHECK(strstr(meniscus_last_error(), "numbers, but"));
  free(wide), free(narrow), free(values), free(corners), free(wide_corners);

  MeniscusCheck check = {.size = sizeof check};
  OK(meniscus_mesh_check(mesh, &check));
  CHECK(check.is_closed_oriented_manifold == 1 && check.boundary_edges == 0 && check.components >= 2);
  CHECK(check.volume > 0.5 * COUNT * pow(SPACING, 3) && check.volume < 2 * COUNT * pow(SPACING, 3));
  CHECK(check.lowest[1] < 0 && check.highest[1] > SIDE * SPACING);
  MeniscusReport report = {.size = sizeof report};
  OK(meniscus_mesh_report(mesh, &report));
  CHECK(report.particles == COUNT && report.spacing == SPACING && report.cell_size == SPACING / 2);
  CHECK(report.spacing_source == MENISCUS_SPACING_SOURCE_GIVEN && report.threads >= 1 && report.seconds > 0);
  CHECK(report.wrapped == 0);
  meniscus_mesh_free(mesh);
  // The particles of the cube's lowest layer are slightly below the periodic box.
  options = OPTIONS("spacing", "0.05", "periodic", "-,0.03,-,-,1.53,-");
  OK(meniscus_reconstruct(&particles, options, &mesh));
  meniscus_options_free(options);
  OK(meniscus_mesh_report(mesh, &report));
  CHECK(report.particles == COUNT && report.wrapped == SIDE * SIDE);
  meniscus_mesh_free(mesh);
}

/// Integers reach the vertices exactly, even if float cannot represent them.
static void integers_reach_the_vertices_exactly(void) {
  static int32_t below[COUNT];
  static uint32_t above[COUNT][2];
  for (int i = 0; i < COUNT; i++) {
    below[i] = -16777217 - 2 * i, above[i][0] = UINT32_MAX - (uint32_t)i, above[i][1] = (uint32_t)i;
  }
  const MeniscusAttribute attributes[] = {
      {.size = sizeof *attributes, .name = "below", .values = below, .components = 1, .number = MENISCUS_TYPE_I32},
      {.size = sizeof *attributes, .name = "above", .values = above, .components = 2, .number = MENISCUS_TYPE_U32},
      {.size = sizeof *attributes, .name = "heat", .values = positions, .components = 1},
  };
  MeniscusParticles particles = particles_of(positions);
  particles.attributes = attributes, particles.attribute_count = 3;
  MeniscusOptions *options = OPTIONS("spacing", "0.05", "attributes", "below,above,heat");
  MeniscusMesh *mesh;
  OK(meniscus_reconstruct(&particles, options, &mesh));
  meniscus_options_free(options);
  const uint64_t vertices = meniscus_mesh_vertex_count(mesh);
  int64_t *whole = malloc(2 * vertices * sizeof *whole), *pairs = malloc(2 * vertices * sizeof *pairs);
  float *rounded = malloc(vertices * sizeof *rounded);
  CHECK(meniscus_mesh_attribute_is_whole(mesh, 0) == 1 && meniscus_mesh_attribute_is_whole(mesh, 1) == 1);
  CHECK(meniscus_mesh_attribute_is_whole(mesh, 2) == 0 && meniscus_mesh_attribute_is_whole(mesh, 3) == 0);
  OK(meniscus_mesh_attribute_whole(mesh, 0, whole, vertices));
  OK(meniscus_mesh_attribute_whole(mesh, 1, pairs, 2 * vertices));
  OK(meniscus_mesh_attribute(mesh, 0, rounded, vertices));
  MeniscusArrays arrays = {.size = sizeof arrays};
  OK(meniscus_mesh_arrays(mesh, &arrays));
  for (uint64_t i = 0; i < vertices; i++) {
    // All attributes of a vertex must come from the same particle.
    const int64_t particle = pairs[2 * i + 1];
    CHECK(particle >= 0 && particle < COUNT);
    CHECK(whole[i] == -16777217 - 2 * particle && pairs[2 * i] == (int64_t)UINT32_MAX - particle);
    CHECK(rounded[i] == (float)whole[i] && arrays.attributes[0].values[i] == rounded[i]);
  }
  CHECK(meniscus_mesh_attribute_whole(mesh, 2, whole, vertices) == MENISCUS_STATUS_REQUEST);
  CHECK(strstr(meniscus_last_error(), "heat: "));
  CHECK(meniscus_mesh_attribute_whole(mesh, 3, whole, vertices) == MENISCUS_STATUS_REQUEST);
  CHECK(meniscus_mesh_attribute_whole(mesh, 0, whole, vertices - 1) == MENISCUS_STATUS_REQUEST);
  free(whole), free(pairs), free(rounded);
  meniscus_mesh_free(mesh);
}

/// Positions with any layout in memory give the same mesh.
static void positions_may_have_any_layout(void) {
  static double axes[3][COUNT];
  static char odd[1 + COUNT * 20];
  for (int i = 0; i < COUNT; i++) {
    for (int axis = 0; axis < 3; axis++) {
      axes[axis][COUNT - 1 - i] = positions[i][axis];
    }
    memcpy(odd + 1 + 20 * i, positions[i], sizeof positions[i]);
  }
  MeniscusParticles packed = particles_of(positions), backwards = packed, unaligned = packed;
  backwards.positions = &axes[0][COUNT - 1], backwards.number = MENISCUS_TYPE_F64;
  backwards.stride = -(ptrdiff_t)sizeof(double), backwards.component_stride = sizeof axes[0];
  unaligned.positions = odd + 1, unaligned.stride = 20;
  MeniscusParticles *all[] = {&packed, &backwards, &unaligned};
  double first = 0;
  for (int i = 0; i < 3; i++) {
    MeniscusMesh *mesh;
    MeniscusArrays arrays = {.size = sizeof arrays};
    OK(meniscus_reconstruct(all[i], NULL, &mesh));
    OK(meniscus_mesh_arrays(mesh, &arrays));
    double sum = 0;
    for (uint64_t k = 0; k < 3 * arrays.vertex_count; k++) {
      sum += arrays.positions[k] * (double)(k % 7 + 1);
    }
    CHECK(sum != 0 && (i == 0 || sum == first));
    first = sum;
    meniscus_mesh_free(mesh);
  }
}

struct reports {
  int calls, stop_after;
  bool inside;
  int stages[8];
};

static int32_t record_progress(void *user, const MeniscusProgress *progress) {
  struct reports *reports = user;
  CHECK(!reports->inside);
  reports->inside = true;
  CHECK(progress->size >= sizeof *progress && progress->done >= 0 && progress->done <= 1 && *progress->name);
  reports->stages[progress->stage]++;
  reports->calls++;
  reports->inside = false;
  return reports->calls == reports->stop_after;
}

static void progress_is_reported_and_can_cancel_the_work(const char *folder) {
  MeniscusParticles particles = particles_of(positions);
  struct reports reports = {0};
  MeniscusOptions *options = OPTIONS("simplify", "0.5");
  OK(meniscus_options_on_progress(options, record_progress, &reports));
  MeniscusMesh *mesh;
  OK(meniscus_reconstruct(&particles, options, &mesh));
  CHECK(reports.stages[MENISCUS_STAGE_COUNTING] && reports.stages[MENISCUS_STAGE_MESHING] && reports.stages[MENISCUS_STAGE_SIMPLIFYING]);
  // The call has returned, so the library must no longer call its callback.
  int calls = reports.calls;
  char path[512];
  snprintf(path, sizeof path, "%s/reports.obj", folder);
  OK(meniscus_mesh_write(mesh, path, 1, NULL));
  CHECK(reports.calls == calls);
  meniscus_mesh_free(mesh);
  // Cancel at the first call of the callback, then at the second call, and so on. Slow work is
  // reported more often, so the number of calls differs from run to run.
  int after = 0;
  do {
    reports = (struct reports){.stop_after = ++after};
    const MeniscusStatus status = meniscus_reconstruct(&particles, options, &mesh);
    if (reports.calls < after) {
      CHECK(status == MENISCUS_STATUS_OK && mesh != NULL);
      meniscus_mesh_free(mesh);
    } else {
      CHECK(reports.calls == after && status == MENISCUS_STATUS_CANCELLED && mesh == NULL);
      CHECK(strcmp(meniscus_last_error(), "cancelled") == 0);
    }
  } while (reports.calls == after);
  CHECK(after > 10);
  // A frame that a callback cancels does not affect later frames.
  MeniscusSimulation *simulation;
  OK(meniscus_simulation_new(options, &simulation));
  meniscus_options_free(options);
  for (int stop_after = 2; stop_after >= 0; stop_after -= 2) {
    reports = (struct reports){.stop_after = stop_after};
    CHECK(meniscus_simulation_frame(simulation, &particles, &mesh) == (stop_after ? MENISCUS_STATUS_CANCELLED : MENISCUS_STATUS_OK));
  }
  meniscus_mesh_free(mesh);
  meniscus_simulation_free(simulation);
}

static void cancel_handle_cancels_all_calls(void) {
  MeniscusParticles particles = particles_of(positions);
  MeniscusCancel *cancel = meniscus_cancel_new();
  MeniscusOptions *options = meniscus_options_new();
  OK(meniscus_options_cancel_by(options, cancel));
  MeniscusOptions *copy = meniscus_options_copy(options);
  MeniscusMesh *mesh;
  OK(meniscus_reconstruct(&particles, options, &mesh));
  meniscus_mesh_free(mesh);
  MeniscusSimulation *simulation;
  OK(meniscus_simulation_new(options, &simulation));
  meniscus_cancel(cancel);
  meniscus_cancel_free(cancel);
  CHECK(meniscus_reconstruct(&particles, options, &mesh) == MENISCUS_STATUS_CANCELLED);
  CHECK(meniscus_reconstruct(&particles, copy, &mesh) == MENISCUS_STATUS_CANCELLED);
  CHECK(meniscus_simulation_frame(simulation, &particles, &mesh) == MENISCUS_STATUS_CANCELLED);
  meniscus_simulation_free(simulation);
  OK(meniscus_options_cancel_by(options, NULL));
  OK(meniscus_reconstruct(&particles, options, &mesh));
  meniscus_mesh_free(mesh);
  meniscus_options_free(options);
  meniscus_options_free(copy);
}

static void a_sampled_frame_gives_several_surfaces(const char *folder) {
  char path[512];
  snprintf(path, sizeof path, "%s/frame.mnf", folder);
  MeniscusParticles particles = particles_of(positions);
  MeniscusOptions *options = OPTIONS("spacing", "0.05");
  MeniscusFrame *frame;
  MeniscusMesh *mesh;
  OK(meniscus_sample(&particles, options, &frame));
  CHECK(meniscus_frame_warning_count(frame) == 0 && meniscus_frame_warning(frame, 0) == NULL);
  uint64_t triangles = 0, bytes = 0;
  for (int i = 0; i < 3; i++) {
    OK(meniscus_options_set_number(options, "smooth", 1.2 + 0.4 * i));
    OK(meniscus_frame_surface(frame, options, &mesh));
    CHECK(meniscus_mesh_triangle_count(mesh) != triangles);
    triangles = meniscus_mesh_triangle_count(mesh);
    meniscus_mesh_free(mesh);
  }
  OK(meniscus_options_set(options, "cell", "0.3"));
  CHECK(meniscus_frame_surface(frame, options, &mesh) == MENISCUS_STATUS_REQUEST && mesh == NULL);
  CHECK(strstr(meniscus_last_error(), "`cell` cannot be changed"));
  meniscus_options_free(options);
  OK(meniscus_frame_pack(frame, path, 1, &bytes));
  CHECK(bytes > 100);
  CHECK(meniscus_frame_pack(frame, path, 0, &bytes) == MENISCUS_STATUS_REQUEST);
  meniscus_frame_free(frame);
  // With the indicator `symmetry`, the library computes a frame's warnings from all cells, on
  // temporary threads.
  MeniscusOptions *symmetry = OPTIONS("spacing", "0.05", "indicator", "symmetry");
  OK(meniscus_sample(&particles, symmetry, &frame));
  meniscus_options_free(symmetry);
  meniscus_frame_free(frame);
  OK(meniscus_sample_file(path, NULL, &frame));
  OK(meniscus_frame_surface(frame, NULL, &mesh));
  meniscus_frame_free(frame);
  CHECK(meniscus_mesh_triangle_count(mesh) > 100);
  meniscus_mesh_free(mesh);
}

static void a_simulation_keeps_the_cells_of_its_first_frame(void) {
  // A cube with this many particles per edge is deeper than the reach of the filters.
  enum { DEEP = 16 };
  static float moved[DEEP * DEEP * DEEP][3];
  MeniscusOptions *options = OPTIONS("smooth", "0.8");
  MeniscusSimulation *simulation;
  OK(meniscus_simulation_new(options, &simulation));
  meniscus_options_free(options);
  CHECK(meniscus_simulation_is_settled(simulation) == 0);
  double cell = 0;
  for (int i = 0; i < 3; i++) {
    // Later frames have fewer particles, so a new estimate of the spacing would differ.
    pour_cube(moved, DEEP, -0.01f * (float)i);
    MeniscusParticles particles = particles_of(moved);
    particles.count = sizeof moved / sizeof *moved - 1000 * (unsigned)i;
    MeniscusMesh *mesh;
    MeniscusReport report = {.size = sizeof report};
    OK(meniscus_simulation_frame(simulation, &particles, &mesh));
    OK(meniscus_mesh_report(mesh, &report));
    CHECK(report.cell_size > 0 && (i == 0 || report.cell_size == cell));
    cell = report.cell_size;
    meniscus_mesh_free(mesh);
  }
  CHECK(meniscus_simulation_is_settled(simulation) == 1);
  // A frame without particles is valid in a simulation, but not in meniscus_reconstruct.
  MeniscusParticles none = {.size = sizeof none};
  MeniscusMesh *dry;
  MeniscusArrays arrays = {.size = sizeof arrays};
  OK(meniscus_simulation_frame(simulation, &none, &dry));
  OK(meniscus_mesh_arrays(dry, &arrays));
  CHECK(arrays.vertex_count == 0 && arrays.triangle_count == 0 && !arrays.positions);
  OK(meniscus_mesh_positions_f32(dry, NULL, 0));
  meniscus_mesh_free(dry);
  CHECK(meniscus_reconstruct(&none, NULL, &dry) == MENISCUS_STATUS_INPUT);
  meniscus_simulation_free(simulation);
}

static int events[13];

static int32_t record_event(void *user, const MeniscusEvent *event) {
  CHECK(user == events && event->size >= sizeof *event && event->text);
  events[event->kind]++;
  return 0;
}

/// Cancels before the first frame. If a callback cancelled after this frame, all other frames might
/// already be finished.
static int32_t cancel_at_start(void *user, const MeniscusEvent *event) {
  (void)user;
  return event->kind == MENISCUS_EVENT_KIND_STARTED;
}

static void a_conversion_reports_finished_and_failed_frames(const char *folder) {
  static char inputs[4][512], output[512];
  const char *names[4];
  for (int i = 0; i < 4; i++) {
    names[i] = inputs[i];
    snprintf(inputs[i], sizeof inputs[i], "%s/water_%d.xyz", folder, i);
    FILE *file = fopen(inputs[i], "wb");
    CHECK(file && fwrite(positions, sizeof positions[0], COUNT, file) == COUNT);
    // Make the third file invalid: append 3 bytes, which are not a complete particle.
    CHECK(i != 2 || fwrite("bad", 1, 3, file) == 3);
    CHECK(fclose(file) == 0);
  }
  snprintf(output, sizeof output, "%s/meshes/mesh_{}.ply", folder);
  MeniscusOptions *options = OPTIONS("overwrite", "true", "threads", "1");
  OK(meniscus_options_on_event(options, record_event, events));
  MeniscusSummary summary = {.size = sizeof summary};
  CHECK(meniscus_convert(names, 4, output, options, &summary) == MENISCUS_STATUS_INCOMPLETE);
  CHECK(summary.made == 3 && summary.failed == 1 && strstr(meniscus_last_error(), "water_2.xyz"));
  CHECK(events[MENISCUS_EVENT_KIND_DONE] == 3 && events[MENISCUS_EVENT_KIND_FAILED] == 1);
  CHECK(events[MENISCUS_EVENT_KIND_STARTED] == 1 && events[MENISCUS_EVENT_KIND_ENDED] == 1);
  CHECK(events[MENISCUS_EVENT_KIND_STAGE] > 3 && events[MENISCUS_EVENT_KIND_OTHER] == 0);
  OK(meniscus_options_on_event(options, cancel_at_start, NULL));
  CHECK(meniscus_convert(names, 4, output, options, NULL) == MENISCUS_STATUS_CANCELLED);
  OK(meniscus_options_set(options, "overwrite", "false"));
  CHECK(meniscus_convert(names, 4, output, options, NULL) == MENISCUS_STATUS_REQUEST);
  meniscus_options_free(options);
}

static int64_t first_done = INT64_MAX, last_done = INT64_MIN;

static int32_t record_frame(void *user, const MeniscusEvent *event) {
  (void)user;
  if (event->kind == MENISCUS_EVENT_KIND_DONE) {
    first_done = event->frame < first_done ? event->frame : first_done;
    last_done = event->frame > last_done ? event->frame : last_done;
  }
  return 0;
}

/// Frames may have negative numbers, and frames of several inputs with the same number are joined.
static void frames_with_negative_numbers_are_joined(const char *folder) {
  char path[512], output[512], inputs[2][512];
  const char *names[] = {inputs[0], inputs[1]};
  for (int part = 0; part < 2; part++) {
    snprintf(inputs[part], sizeof inputs[part], "%s/part%c_{}.xyz", folder, 'a' + part);
    for (int frame = -2; frame <= 1; frame++) {
      snprintf(path, sizeof path, "%s/part%c_%d.xyz", folder, 'a' + part, frame);
      FILE *file = fopen(path, "wb");
      const size_t half = COUNT / 2, count = part ? COUNT - half : half;
      CHECK(file && fwrite(positions[part ? half : 0], sizeof positions[0], count, file) == count);
      CHECK(fclose(file) == 0);
    }
  }
  snprintf(output, sizeof output, "%s/joined/mesh_{}.ply", folder);
  MeniscusOptions *options = OPTIONS("overwrite", "true", "together", "true", "end", "0", "frames", "-1..5");
  OK(meniscus_options_set_number(options, "start", -2));
  OK(meniscus_options_on_event(options, record_frame, NULL));
  MeniscusSummary summary = {.size = sizeof summary};
  OK(meniscus_convert(names, 2, output, options, &summary));
  meniscus_options_free(options);
  CHECK(summary.made == 2 && summary.failed == 0 && summary.missing == 0 && summary.particles == 2 * COUNT);
  CHECK(first_done == -1 && last_done == 0);
  snprintf(path, sizeof path, "%s/joined/mesh_-1.ply", folder);
  CHECK(access(path, R_OK) == 0);
}

static void *work(void *threads) {
  MeniscusParticles particles = particles_of(positions);
  const unsigned count = *(unsigned *)threads;
  MeniscusOptions *options = meniscus_options_new();
  OK(meniscus_options_set_number(options, "threads", count));
  uint64_t sum = 0;
  for (int i = 0; i < 3; i++) {
    MeniscusMesh *mesh;
    OK(meniscus_reconstruct(&particles, options, &mesh));
    sum += meniscus_mesh_vertex_count(mesh);
    meniscus_mesh_free(mesh);
    // A failure on another thread must not change the message of this thread.
    MeniscusOptions *wrong = meniscus_options_new();
    OK(meniscus_options_set_number(wrong, "spacing", -1.0 - count));
    char expected[16];
    snprintf(expected, sizeof expected, "got -%u", 1 + count);
    CHECK(meniscus_reconstruct(&particles, wrong, &mesh) == MENISCUS_STATUS_REQUEST && mesh == NULL);
    CHECK(strstr(meniscus_last_error(), expected));
    meniscus_options_free(wrong);
  }
  meniscus_options_free(options);
  return (void *)(uintptr_t)sum;
}

static void two_threads_get_separate_results_and_messages(void) {
  pthread_t threads[2];
  unsigned counts[2] = {1, 2};
  void *sums[2];
  for (int i = 0; i < 2; i++) {
    CHECK(pthread_create(&threads[i], NULL, work, &counts[i]) == 0);
  }
  for (int i = 0; i < 2; i++) {
    CHECK(pthread_join(threads[i], &sums[i]) == 0);
  }
  CHECK(sums[0] == sums[1] && sums[0] != NULL);
}

/// Every key can be set, and has a line of help.
static void all_keys_can_be_set_and_have_help(void) {
  MeniscusOptions *options = meniscus_options_new();
  size_t count = 0;
  for (const char *key; (key = meniscus_options_key(count)); count++) {
    const char *help = meniscus_options_help(count);
    CHECK(help && strlen(help) > 10 && !strchr(help, '\n'));
    OK(meniscus_options_set(options, key, NULL));
  }
  CHECK(count > 30 && !meniscus_options_help(count) && !meniscus_options_key(SIZE_MAX));
  meniscus_options_free(options);
}

/// An option set from text and an option set from numbers give the same mesh.
static void text_and_numbers_set_the_same_options(void) {
  const double origin[] = {0.01, 0, -0.5};
  const double tank[] = {-0.02, -INFINITY, -INFINITY, 0.4, INFINITY, INFINITY};
  MeniscusOptions *all[] = {
      OPTIONS("spacing", "5e-2", "origin", "0.01 0 -0.5", "domain", "-0.02,-,-,0.4,-,-", "normals",
              "true", "memory", "1GiB"),
      meniscus_options_new(),
  };
  OK(meniscus_options_set_number(all[1], "spacing", 0.05));
  OK(meniscus_options_set_numbers(all[1], "origin", origin, 3));
  OK(meniscus_options_set_numbers(all[1], "domain", tank, 6));
  OK(meniscus_options_set_number(all[1], "normals", 1));
  OK(meniscus_options_set_number(all[1], "memory", 1 << 30));
  MeniscusParticles particles = particles_of(positions);
  MeniscusMesh *meshes[2];
  MeniscusArrays arrays[2] = {{.size = sizeof arrays[0]}, {.size = sizeof arrays[1]}};
  for (int i = 0; i < 2; i++) {
    OK(meniscus_reconstruct(&particles, all[i], &meshes[i]));
    meniscus_options_free(all[i]);
    OK(meniscus_mesh_arrays(meshes[i], &arrays[i]));
    CHECK(arrays[i].normals && arrays[i].vertex_count == arrays[0].vertex_count);
  }
  const size_t bytes = 3 * arrays[0].vertex_count * sizeof(double);
  CHECK(memcmp(arrays[0].positions, arrays[1].positions, bytes) == 0);
  meniscus_mesh_free(meshes[0]), meniscus_mesh_free(meshes[1]);
}

static int test(int count, char **arguments) {
  CHECK(count == 2);
  pour(positions, 0);
  CHECK(strcmp(meniscus_last_error(), "") == 0 && strlen(meniscus_version()) >= 5);
  all_keys_can_be_set_and_have_help();
  text_and_numbers_set_the_same_options();
  copies_equal_arrays();
  integers_reach_the_vertices_exactly();
  positions_may_have_any_layout();
  progress_is_reported_and_can_cancel_the_work(arguments[1]);
  cancel_handle_cancels_all_calls();
  a_sampled_frame_gives_several_surfaces(arguments[1]);
  a_simulation_keeps_the_cells_of_its_first_frame();
  a_conversion_reports_finished_and_failed_frames(arguments[1]);
  frames_with_negative_numbers_are_joined(arguments[1]);
  two_threads_get_separate_results_and_messages();
  puts("the library keeps the guarantees of the header");
  return 0;
}
