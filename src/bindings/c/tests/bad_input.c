// Checks that bad input of every kind gives a code and a precise message, and never crashes:
// `bad_input FOLDER`.
#include "water.h"

static float positions[COUNT][3];

/// Checks that a call has failed with this code and message, and has returned no handle.
static void check_failure(MeniscusStatus status, MeniscusStatus expected, const char *message, const void *made, int line) {
  if (status != expected || made || !strstr(meniscus_last_error(), message)) {
    fprintf(stderr, "line %d: status %d instead of %d: %s\n  the message must contain: %s\n", line, status, expected, meniscus_last_error(), message);
    exit(1);
  }
}

#define REFUSED(kind, message, call)                                                                           \
  do {                                                                                                         \
    MeniscusMesh *mesh = (MeniscusMesh *)&positions;                                                           \
    MeniscusStatus status = (call);                                                                            \
    check_failure(status, MENISCUS_STATUS_##kind, message, mesh, __LINE__);                                          \
  } while (0)

/// Expects a failure when an option is set, or when particles are reconstructed with the options.
static void check_invalid_options(const char *message, const char *const *pairs, int line) {
  MeniscusOptions *options = meniscus_options_new();
  MeniscusStatus status = MENISCUS_STATUS_OK;
  for (; *pairs && status == MENISCUS_STATUS_OK; pairs += 2) {
    status = meniscus_options_set(options, pairs[0], pairs[1]);
  }
  if (status != MENISCUS_STATUS_OK) {
    check_failure(status, MENISCUS_STATUS_REQUEST, message, NULL, line);
  } else {
    const MeniscusParticles water = particles_of(positions);
    MeniscusMesh *mesh = (MeniscusMesh *)&positions;
    status = meniscus_reconstruct(&water, options, &mesh);
    check_failure(status, MENISCUS_STATUS_REQUEST, message, mesh, line);
    MeniscusSimulation *simulation = (MeniscusSimulation *)&positions;
    status = meniscus_simulation_new(options, &simulation);
    if (status == MENISCUS_STATUS_OK) {  // The library looks up attributes only when it gets a frame.
      meniscus_simulation_free(simulation);
    } else {
      check_failure(status, MENISCUS_STATUS_REQUEST, message, simulation, line);
    }
  }
  meniscus_options_free(options);
}

#define OPTION(message, ...) \
  check_invalid_options(message, (const char *const[]){__VA_ARGS__, NULL}, __LINE__)

#define PARTICLES(kind, message, ...)                                                                          \
  do {                                                                                                         \
    MeniscusParticles wrong = {.size = sizeof wrong, .count = COUNT, .positions = positions, __VA_ARGS__};     \
    REFUSED(kind, message, meniscus_reconstruct(&wrong, NULL, &mesh));                                         \
  } while (0)

#define ATTRIBUTE(message, ...)                                                                                \
  do {                                                                                                         \
    const MeniscusAttribute odd = {.size = sizeof odd, .name = "heat", .values = positions, .components = 1, __VA_ARGS__}; \
    PARTICLES(REQUEST, message, .attributes = &odd, .attribute_count = 1);                                   \
  } while (0)

#pragma GCC diagnostic ignored "-Woverride-init"

static void options_are_refused(void) {
  OPTION("spacing must be positive and finite, got -0.05", "spacing", "-0.05");
  OPTION("spacing must be positive and finite, got NaN", "spacing", "nan");
  OPTION("spacing must be positive and finite, got inf", "spacing", "inf");
  OPTION("spacing must be positive and finite, got 0", "spacing", "0");
  OPTION("radius must be positive and finite, got -1", "radius", "-1");
  OPTION("`radius` cannot be used with `spacing`", "radius", "1", "spacing", "2");
  OPTION("`cell-size` cannot be used with `cell`", "cell", "1", "cell-size", "2");
  OPTION("cell-size must be positive", "cell-size", "nan");
  OPTION("cell must be positive", "cell", "-0.5");
  OPTION("origin", "origin", "nan,0,0");
  OPTION("domain", "domain", "1,1,1,0,0,0");
  OPTION("periodic box", "periodic", "0,0,0,1,0,1");
  OPTION("periodic", "periodic", "-,-,-,-,-,-");
  OPTION("`periodic-mesh` has no effect without `periodic`", "periodic-mesh", "cut");
  OPTION("smooth must be", "smooth", "-1");
  OPTION("smooth must be", "smooth", "nan");
  OPTION("sigma must be", "indicator", "counting", "sigma", "-1");
  OPTION("mu0 must be", "indicator", "counting", "mu0", "inf");
  OPTION("`mu0` needs the indicator counting, but `indicator` is cloud", "mu0", "1");
  OPTION("iso must be", "indicator", "symmetry", "iso", "2");
  OPTION("`iso` cannot be used if `method` is zhu-bridson", "method", "zhu-bridson", "iso", "0.5");
  OPTION("simplify must be", "simplify", "-1");
  OPTION("smallest-component must be", "smallest-component", "nan");
  OPTION("the memory limit must be at least", "memory", "1");
  OPTION("cannot start threads: the number of threads must be from 1 to 1024, got 4000000000", "threads", "4000000000");
  OPTION("device cannot be used with backend cpu", "backend", "cpu", "device", "0");
  OPTION("backend: kernel methods run only on the CPU", "backend", "vulkan", "method", "mueller");
  OPTION("backend: kernel methods run only on the CPU", "device", "0", "method", "yu-turk");
  OPTION("no attribute \"heat\"", "attributes", "heat");
  OPTION("fps works only with meniscus_convert", "fps", "25");
  OPTION("resume works only with meniscus_convert", "resume", "false");
}

static void keys_and_values_are_refused(void) {
  OPTION("no option has the key \"spacng\"", "spacng", "1");
  OPTION("no option has the key \"cell_size\"", "cell_size", "1");
  OPTION("no option has the key \"\"", "", "1");
  OPTION("key is not UTF-8", "\xff", "1");
  OPTION("spacing: expected a number, got \"thick\"", "spacing", "thick");
  OPTION("spacing: expected a number, got \"0,05\"", "spacing", "0,05");
  OPTION("spacing: expected a number, got \"\"", "spacing", "");
  OPTION("normals: expected true or false, got \"1\"", "normals", "1");
  OPTION("smallest-drop: expected a whole number, 0 or greater, got \"-1\"", "smallest-drop", "-1");
  OPTION("indicator: expected one of cloud, counting, symmetry, got \"4\"", "indicator", "4");
  OPTION("method: expected one of dif, ", "method", "Mueller");
  OPTION("periodic-mesh: expected one of ", "periodic-mesh", "open");
  OPTION("up: expected one of y, z, got \"x\"", "up", "x");
  OPTION("particles-up: expected one of y, z", "particles-up", "");
  OPTION("format: expected one of bgeo, ", "format", "doc");
  OPTION("backend: expected one of auto, cpu, vulkan, got \"gpu\"", "backend", "gpu");
  OPTION("origin: expected 3 numbers: x, y, z, got \"1,2\"", "origin", "1,2");
  OPTION("domain: expected auto or 6 numbers: ", "domain", "0,0,0,1,1");
  OPTION("memory: expected a number of bytes, or a size such as 512MiB", "memory", "much");
  OPTION("step: expected a whole number, 1 or greater, got \"0\"", "step", "0");
  OPTION("start: expected a whole number, got \"1.5\"", "start", "1.5");
  OPTION("end: expected a whole number, got \"last\"", "end", "last");
  OPTION("together: expected true or false, got \"a,b\"", "together", "a,b");
  OPTION("frames: expected the first and the last frame number, such as 100..199, got \"5..3\"", "frames", "5..3");
  OPTION("device is not UTF-8", "device", "\xff");
  OPTION("where is not UTF-8", "where", "\xff");
  OPTION("attributes is not UTF-8", "attributes", "\xe9t\xe9");

  MeniscusOptions *options = meniscus_options_new();
  MeniscusParticles water = particles_of(positions);
  const double numbers[] = {NAN, 0, 0, 1, 1, 1};
#define SET(message, call) check_failure(call, MENISCUS_STATUS_REQUEST, message, NULL, __LINE__)
  SET("options is NULL", meniscus_options_set(NULL, "spacing", "1"));
  SET("options is NULL", meniscus_options_set_number(NULL, "spacing", 1));
  SET("options is NULL", meniscus_options_on_progress(NULL, NULL, NULL));
  SET("options is NULL", meniscus_options_on_event(NULL, NULL, NULL));
  SET("options is NULL", meniscus_options_cancel_by(NULL, NULL));
  SET("key is NULL", meniscus_options_set(options, NULL, "1"));
  SET("no option has the key \"thread\"", meniscus_options_set_number(options, "thread", 1));
  SET("threads: expected a whole number, 0 or greater, got [1.5]",
      meniscus_options_set_number(options, "threads", 1.5));
  SET("smallest-drop: expected a smaller number",
      meniscus_options_set_number(options, "smallest-drop", 1e10));
  SET("normals: expected true or false, got [2.0]",
      meniscus_options_set_number(options, "normals", 2));
  SET("up: expected one of y, z", meniscus_options_set_number(options, "up", 1));
  SET("attributes: expected text", meniscus_options_set_number(options, "attributes", 1));
  SET("scratch: expected text", meniscus_options_set_number(options, "scratch", 1));
  SET("origin: expected 3 numbers: x, y, z, got [NaN, 0.0]",
      meniscus_options_set_numbers(options, "origin", numbers, 2));
  SET("origin: expected 3 numbers", meniscus_options_set_numbers(options, "origin", NULL, 0));
  SET("origin is NULL, but its count is 3",
      meniscus_options_set_numbers(options, "origin", NULL, 3));
  SET("origin: ", meniscus_options_set_numbers(options, "origin", numbers, SIZE_MAX));
  SET("spacing: expected a number, got [NaN, 0.0]",
      meniscus_options_set_numbers(options, "spacing", numbers, 2));
  // The rejected values have not changed the options. NULL resets an option to its default.
  MeniscusMesh *mesh;
  OK(meniscus_options_set_numbers(options, "origin", numbers, 3));
  OK(meniscus_options_set_number(options, "watch", INFINITY));
  OK(meniscus_options_set(options, "origin", NULL));
  OK(meniscus_options_set(options, "watch", NULL));
  OK(meniscus_options_set(options, "scratch", NULL));
  SET("no option has the key \"spacng\"", meniscus_options_set(options, "spacng", NULL));
  OK(meniscus_reconstruct(&water, options, &mesh));
  meniscus_mesh_free(mesh);
  meniscus_options_free(options);
  meniscus_options_free(NULL);
}

static void particles_are_refused(void) {
  static float broken[COUNT][3];
  memcpy(broken, positions, sizeof broken);
  broken[5][1] = NAN;
  REFUSED(REQUEST, "particles is NULL", meniscus_reconstruct(NULL, NULL, &mesh));
  PARTICLES(INPUT, "particle 5 ", .positions = broken);
  broken[5][1] = 3e38f;
  PARTICLES(INPUT, "particle 5 ", .positions = broken);
  MeniscusParticles far = particles_of(broken);
  MeniscusOptions *near = OPTIONS("spacing", "0.05");
  REFUSED(INPUT, "particle 5 ", meniscus_reconstruct(&far, near, &mesh));
  meniscus_options_free(near);
  PARTICLES(INPUT, "no particles", .count = 0);
  PARTICLES(REQUEST, "particles.positions is NULL, but count is 1005", .positions = NULL);
  PARTICLES(REQUEST, "particles.positions: ", .count = UINT64_MAX);
  PARTICLES(REQUEST, "particles.positions: ", .stride = PTRDIFF_MAX);
  PARTICLES(REQUEST, "particles.positions: ", .component_stride = PTRDIFF_MIN);
  PARTICLES(REQUEST, "particles.number is 4, which is not a MeniscusType", .number = 4);
  PARTICLES(REQUEST, "particles.number is 2, but must be MENISCUS_TYPE_F32 or MENISCUS_TYPE_F64", .number = MENISCUS_TYPE_I32);
  PARTICLES(REQUEST, "particles.reserved is 1, but must be 0", .reserved = 1);
  PARTICLES(REQUEST, "particles.size is 7;", .size = 7);
  PARTICLES(REQUEST, "particles.attributes is NULL, but attribute_count is 2", .attribute_count = 2);
  ATTRIBUTE("particles.attributes[0].size is 1;", .size = 1);
  ATTRIBUTE("particles.attributes[0].name is NULL or empty", .name = NULL);
  ATTRIBUTE("particles.attributes[0].name is NULL or empty", .name = "");
  ATTRIBUTE("particles.attributes[0].name is not UTF-8", .name = "\x80");
  ATTRIBUTE("particles.attributes[0].components is 0, but must be 1 to 65536", .components = 0);
  ATTRIBUTE("particles.attributes[0].components is 4294967295", .components = UINT32_MAX);
  ATTRIBUTE("particles.attributes[0].values is NULL", .values = NULL);
  ATTRIBUTE("particles.attributes[0].number is -3", .number = -3);
  ATTRIBUTE("particles.attributes[0].values: ", .stride = PTRDIFF_MAX / 2);
  const MeniscusAttribute twins[2] = {
      {.size = sizeof *twins, .name = "heat", .values = positions, .components = 1},
      {.size = sizeof *twins, .name = "heat", .values = positions, .components = 1}};
  PARTICLES(REQUEST, "another attribute is called \"heat\"", .attributes = twins, .attribute_count = 2);
  // Test particles that all have the same position, and particles that are all skipped as invalid.
  static float nowhere[COUNT][3];
  MeniscusParticles same = particles_of(nowhere);
  REFUSED(INPUT, "spacing", meniscus_reconstruct(&same, NULL, &mesh));
  memset(nowhere, 0xff, sizeof nowhere);
  MeniscusOptions *skip = OPTIONS("spacing", "1", "skip-invalid", "true");
  REFUSED(INPUT, "no particles", meniscus_reconstruct(&same, skip, &mesh));
  meniscus_options_free(skip);
}

static void files_are_refused(const char *folder) {
  char path[512];
  MeniscusParticles water = particles_of(positions);
  REFUSED(REQUEST, "path is NULL", meniscus_reconstruct_file(NULL, NULL, &mesh));
  REFUSED(INPUT, "there/is/none.bgeo", meniscus_reconstruct_file("there/is/none.bgeo", NULL, &mesh));
  REFUSED(REQUEST, "mesh.doc", meniscus_reconstruct_file("mesh.doc", NULL, &mesh));
  snprintf(path, sizeof path, "%s/bad.npy", folder);
  FILE *file = fopen(path, "wb");
  CHECK(file && fputs("\x93NUMPY no", file) >= 0 && fclose(file) == 0);
  REFUSED(INPUT, path, meniscus_reconstruct_file(path, NULL, &mesh));

  MeniscusMesh *made;
  OK(meniscus_reconstruct(&water, NULL, &made));
  snprintf(path, sizeof path, "%s/there.ply", folder);
  OK(meniscus_mesh_write(made, path, 1, NULL));
#define WRITE(kind, message, call)                                                                             \
  do {                                                                                                         \
    MeniscusStatus status = (call);                                                                            \
    check_failure(status, MENISCUS_STATUS_##kind, message, NULL, __LINE__);                                          \
  } while (0)
  WRITE(REQUEST, "already exists", meniscus_mesh_write(made, path, 0, NULL));
  WRITE(REQUEST, "path is NULL", meniscus_mesh_write(made, NULL, 0, NULL));
  WRITE(REQUEST, "mesh is NULL", meniscus_mesh_write(NULL, path, 0, NULL));
  WRITE(REQUEST, "mesh.doc", meniscus_mesh_write(made, "mesh.doc", 0, NULL));
  // The library creates a missing folder, unless a file has the folder's name.
  char below[sizeof path + 32];
  snprintf(below, sizeof below, "%s/none/mesh.ply", path);
  WRITE(OUTPUT, "none/mesh.ply", meniscus_mesh_write(made, below, 0, NULL));
  WRITE(REQUEST, "already exists", meniscus_check_output(path, NULL, 0));
  OK(meniscus_check_output(path, NULL, 1));
  MeniscusOptions *heat = OPTIONS("attributes", "heat");
  WRITE(REQUEST, ".obj cannot store `attributes`", meniscus_check_output("new.obj", heat, 0));
  meniscus_options_free(heat);
  OK(meniscus_check_output("new.obj", NULL, 0));
  CHECK(access("new.obj", F_OK) != 0);
  char text[8] = "1234567";
  size_t length = 9;
  OK(meniscus_mesh_format_warnings(made, "a.ply", text, sizeof text, &length));
  CHECK(length == 0 && *text == 0);
  WRITE(REQUEST, "a.txt: unknown extension", meniscus_mesh_format_warnings(made, "a.txt", text, sizeof text, &length));

  float number;
  uint64_t wide;
  WRITE(REQUEST, "out is NULL", meniscus_mesh_positions_f32(made, NULL, UINT64_MAX));
  WRITE(REQUEST, "out holds 1 numbers", meniscus_mesh_positions_f32(made, &number, 1));
  WRITE(REQUEST, "out holds 1 numbers", meniscus_mesh_triangles_u64(made, &wide, 1));
  WRITE(REQUEST, "out is not aligned to 8 bytes", meniscus_mesh_triangles_u64(made, (void *)((char *)&wide + 1), 1 << 30));
  WRITE(REQUEST, "no normals", meniscus_mesh_normals(made, &number, 1));
  WRITE(REQUEST, "attribute index 0 is out of range", meniscus_mesh_attribute(made, 0, &number, 1));
  WRITE(REQUEST, "mesh is NULL", meniscus_mesh_normals(NULL, &number, 1));
  WRITE(REQUEST, "arrays is NULL", meniscus_mesh_arrays(made, NULL));
  MeniscusArrays arrays = {.size = 3};
  WRITE(REQUEST, "arrays.size is 3;", meniscus_mesh_arrays(made, &arrays));
  WRITE(REQUEST, "report is NULL", meniscus_mesh_report(made, NULL));
  WRITE(REQUEST, "check is NULL", meniscus_mesh_check(made, NULL));
  WRITE(REQUEST, "mesh is NULL", meniscus_reconstruct(&water, NULL, NULL));
  meniscus_mesh_free(made);

  REFUSED(REQUEST, "frame is NULL", meniscus_frame_surface(NULL, NULL, &mesh));
  WRITE(REQUEST, "frame is NULL", meniscus_frame_pack(NULL, "a.mnf", 0, NULL));
  REFUSED(REQUEST, "simulation is NULL", meniscus_simulation_frame(NULL, &water, &mesh));
  MeniscusFrame *frame;
  OK(meniscus_sample(&water, NULL, &frame));
  WRITE(REQUEST, "a.ply: a packed frame needs the extension .mnf", meniscus_frame_pack(frame, "a.ply", 0, NULL));
  meniscus_frame_free(frame);
  MeniscusOptions *kernels = OPTIONS("method", "zhu-bridson");
  OK(meniscus_sample(&water, kernels, &frame));
  meniscus_options_free(kernels);
  WRITE(REQUEST, "`method` is not supported when packing", meniscus_frame_pack(frame, "a.mnf", 0, NULL));
  meniscus_frame_free(frame);
  // All queries and frees accept NULL.
  CHECK(!meniscus_mesh_vertex_count(NULL) && !meniscus_mesh_triangle_count(NULL) && !meniscus_mesh_has_normals(NULL));
  CHECK(!meniscus_mesh_attribute_count(NULL) && !meniscus_mesh_attribute_name(NULL, 0) && !meniscus_mesh_warning(NULL, 0));
  CHECK(!meniscus_mesh_warning_count(NULL) && !meniscus_frame_warning_count(NULL) && !meniscus_frame_warning(NULL, 0));
  CHECK(!meniscus_simulation_is_settled(NULL) && !meniscus_mesh_attribute_components(NULL, 0));
  meniscus_mesh_free(NULL), meniscus_frame_free(NULL), meniscus_simulation_free(NULL);
  meniscus_cancel_free(NULL), meniscus_cancel(NULL);
}

static void conversions_are_refused(const char *folder) {
  char output[512], input[512];
  snprintf(output, sizeof output, "%s/none/mesh_{}.ply", folder);
  snprintf(input, sizeof input, "%s/none_{}.bgeo", folder);
  const char *inputs[] = {input, NULL};
#define CONVERT(kind, message, inputs, count, output, ...) \
  do { \
    MeniscusOptions *options = OPTIONS(__VA_ARGS__); \
    WRITE(kind, message, meniscus_convert(inputs, count, output, options, NULL)); \
    meniscus_options_free(options); \
  } while (0)
  CONVERT(INPUT, "no file matches this pattern", inputs, 1, output, "start", "0");
  CONVERT(REQUEST, "input_count is 0", inputs, 0, output, "start", "0");
  CONVERT(REQUEST, "inputs is NULL", NULL, 1, output, "start", "0");
  CONVERT(REQUEST, "inputs[1] is NULL", inputs, 2, output, "start", "0");
  CONVERT(REQUEST, "output is NULL", inputs, 1, NULL, "start", "0");
  CONVERT(REQUEST, "one file for all frames", inputs, 1, "one.ply", "start", "0");
  CONVERT(REQUEST, "the first frame (4) is after the last (0)", inputs, 1, output, "start", "4", "end", "0");
  CONVERT(REQUEST, "the first frame (-1) is after the last (-3)", inputs, 1, output, "start", "-1", "end", "-3");
  CONVERT(REQUEST, "fps must be", inputs, 1, output, "fps", "-1");
  CONVERT(REQUEST, "fps must be", inputs, 1, output, "fps", "nan");
  CONVERT(REQUEST, "watch must be at least 0 seconds", inputs, 1, output, "watch", "nan");
  MeniscusSummary summary = {.size = 5};
  WRITE(REQUEST, "summary.size is 5;", meniscus_convert(inputs, 1, output, NULL, &summary));
}

static int test(int count, char **arguments) {
  CHECK(count == 2);
  pour(positions, 0);
  options_are_refused();
  keys_and_values_are_refused();
  particles_are_refused();
  files_are_refused(arguments[1]);
  conversions_are_refused(arguments[1]);
  puts("all bad input gave the expected code and message");
  return 0;
}
