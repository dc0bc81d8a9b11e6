// Bad input of every kind is a code and a message that says what and where, and never a crash: `bad_input FOLDER`.
#include "water.h"

static float positions[COUNT][3];
static const double nan_corner[] = {NAN, 0, 0}, flat[] = {0, 0, 0, 1, 0, 1}, inside_out[] = {1, 1, 1, 0, 0, 0};
static const double open_box[] = {-INFINITY, -INFINITY, -INFINITY, INFINITY, INFINITY, INFINITY};
static const char *heat[] = {"heat"}, *latin[] = {"\xe9t\xe9"}, *none[] = {NULL};

/// What a call said of the failure of another.
static void refused(MeniscusStatus status, MeniscusStatus expected, const char *message, const void *made, int line) {
  if (status != expected || made || !strstr(meniscus_last_error(), message)) {
    fprintf(stderr, "line %d: %d, not %d: %s\n  does not say: %s\n", line, status, expected, meniscus_last_error(), message);
    exit(1);
  }
}

#define REFUSED(kind, message, call)                                                                           \
  do {                                                                                                         \
    MeniscusMesh *mesh = (MeniscusMesh *)&positions;                                                           \
    MeniscusStatus status = (call);                                                                            \
    refused(status, MENISCUS_STATUS_##kind, message, mesh, __LINE__);                                          \
  } while (0)

/// Refuses options in which one field is wrong.
#define OPTION(message, ...)                                                                                   \
  do {                                                                                                         \
    MeniscusOptions options = {.size = sizeof options, __VA_ARGS__};                                           \
    REFUSED(REQUEST, message, meniscus_reconstruct(&water, &options, &mesh));                                  \
    MeniscusSimulation *simulation = (MeniscusSimulation *)&positions;                                         \
    MeniscusStatus status = meniscus_simulation_new(&options, &simulation);                                    \
    if (status == MENISCUS_STATUS_OK) { /* Attributes are looked for in frames. */                             \
      meniscus_simulation_free(simulation);                                                                    \
    } else {                                                                                                   \
      refused(status, MENISCUS_STATUS_REQUEST, message, simulation, __LINE__);                                 \
    }                                                                                                          \
  } while (0)

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
  MeniscusParticles water = particles_of(positions);
  OPTION("options.spacing must be positive and finite, not -0.05", .spacing = -0.05);
  OPTION("options.spacing must be positive and finite, not NaN", .spacing = NAN);
  OPTION("options.spacing must be positive and finite, not inf", .spacing = INFINITY);
  OPTION("options.radius must be positive and finite, not -1", .radius = -1);
  OPTION("options.radius and options.spacing exclude each other", .radius = 1, .spacing = 2);
  OPTION("options.cell and options.cell_size exclude each other", .cell = 1, .cell_size = 2);
  OPTION("options.cell_size must be positive", .cell_size = NAN);
  OPTION("options.cell must be positive", .cell = -0.5);
  OPTION("origin", .origin = nan_corner);
  OPTION("domain", .domain = inside_out);
  OPTION("periodic box", .periodic = flat);
  OPTION("periodic", .periodic = open_box);
  OPTION("periodic", .periodic_mesh = MENISCUS_PERIODIC_MESH_CUT);
  OPTION("smooth must be", .smooth = -1);
  OPTION("smooth must be", .smooth = NAN);
  OPTION("sigma must be", .indicator = MENISCUS_INDICATOR_COUNTING, .sigma = -1);
  OPTION("mu0 must be", .indicator = MENISCUS_INDICATOR_COUNTING, .mu0 = INFINITY);
  OPTION("options.mu0 has no meaning for options.indicator cloud", .mu0 = 1);
  OPTION("options.iso must be", .indicator = MENISCUS_INDICATOR_SYMMETRY, .iso = 2);
  OPTION("options.iso has no meaning for this options.method", .method = MENISCUS_METHOD_ZHU_BRIDSON, .iso = 0.5);
  OPTION("options.simplify must be", .simplify = -1);
  OPTION("options.smallest_component must be", .smallest_component = NAN);
  OPTION("memory of at least", .memory = 1);
  OPTION("threads cannot be started: their number must be 1 to 1024", .threads = 4000000000u);
  OPTION("options.indicator is 4, which is no MeniscusIndicator", .indicator = 4);
  OPTION("options.method is -1, which is no MeniscusMethod", .method = -1);
  OPTION("options.periodic_mesh is 9, which is no MeniscusPeriodicMesh", .periodic_mesh = 9);
  OPTION("options.up is 3, which is no MeniscusUp", .up = 3);
  OPTION("options.particles_up is 3, which is no MeniscusUp", .particles_up = 3);
  OPTION("options.format is 12, which is no MeniscusFormat", .format = 12);
  OPTION("options.backend is 2147483647, which is no MeniscusBackend", .backend = INT32_MAX);
  OPTION("options.device: options.backend is the CPU", .backend = MENISCUS_BACKEND_CPU, .device = "0");
  OPTION("options.backend: kernel methods run on the CPU", .backend = MENISCUS_BACKEND_VULKAN, .method = MENISCUS_METHOD_MUELLER);
  OPTION("options.backend: kernel methods run on the CPU", .device = "0", .method = MENISCUS_METHOD_YU_TURK);
  OPTION("options.device is not UTF-8", .device = "\xff");
  OPTION("options.particle_type is not UTF-8", .particle_type = "\xff");
  OPTION("no attribute \"heat\"", .attributes = heat, .attribute_count = 1);
  OPTION("options.attributes[0] is not UTF-8", .attributes = latin, .attribute_count = 1);
  OPTION("options.attributes[0] is NULL", .attributes = none, .attribute_count = 1);
  OPTION("options.attributes is NULL, and 3 are said to be there", .attribute_count = 3);
  OPTION("options.attributes: ", .attributes = heat, .attribute_count = SIZE_MAX);
  OPTION("options: its size is 0; sizeof(MeniscusOptions) is ", .size = 0);
  OPTION("options: its size is 13;", .size = 13);
  OPTION("options: its size is 1048576;", .size = 1 << 20);
  // A newer caller's structure is taken, as long as it asks for nothing that is not known here.
  struct { MeniscusOptions options; uint64_t newer[2]; } newer = {{.size = sizeof newer}, {0, 0}};
  MeniscusMesh *mesh;
  OK(meniscus_reconstruct(&water, &newer.options, &mesh));
  meniscus_mesh_free(mesh);
  newer.newer[1] = 1;
  REFUSED(REQUEST, "options: it is of a newer version", meniscus_reconstruct(&water, &newer.options, &mesh));
  // So is an older one's, which ends early: what follows is not looked at.
  MeniscusOptions older = {.size = offsetof(MeniscusOptions, radius), .spacing = SPACING, .radius = NAN};
  OK(meniscus_reconstruct(&water, &older, &mesh));
  meniscus_mesh_free(mesh);
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
  MeniscusOptions near = {.size = sizeof near, .spacing = SPACING};
  REFUSED(INPUT, "particle 5 ", meniscus_reconstruct(&far, &near, &mesh));
  PARTICLES(INPUT, "no particles", .count = 0);
  PARTICLES(REQUEST, "particles.positions is NULL, and 1005 particles are said to be there", .positions = NULL);
  PARTICLES(REQUEST, "particles.positions: ", .count = UINT64_MAX);
  PARTICLES(REQUEST, "particles.positions: ", .stride = PTRDIFF_MAX);
  PARTICLES(REQUEST, "particles.positions: ", .component_stride = PTRDIFF_MIN);
  PARTICLES(REQUEST, "particles.number is 2, which is no MeniscusType", .number = 2);
  PARTICLES(REQUEST, "particles.reserved is 1, and must be 0", .reserved = 1);
  PARTICLES(REQUEST, "particles: its size is 7;", .size = 7);
  PARTICLES(REQUEST, "particles.attributes is NULL, and 2 are said to be there", .attribute_count = 2);
  ATTRIBUTE("particles.attributes[0]: its size is 1;", .size = 1);
  ATTRIBUTE("particles.attributes[0].name is NULL, or empty", .name = NULL);
  ATTRIBUTE("particles.attributes[0].name is NULL, or empty", .name = "");
  ATTRIBUTE("particles.attributes[0].name is not UTF-8", .name = "\x80");
  ATTRIBUTE("particles.attributes[0].components is 0, and must be 1 to 65536", .components = 0);
  ATTRIBUTE("particles.attributes[0].components is 4294967295", .components = UINT32_MAX);
  ATTRIBUTE("particles.attributes[0].values is NULL", .values = NULL);
  ATTRIBUTE("particles.attributes[0].number is -3", .number = -3);
  ATTRIBUTE("particles.attributes[0].values: ", .stride = PTRDIFF_MAX / 2);
  const MeniscusAttribute twins[2] = {
      {.size = sizeof *twins, .name = "heat", .values = positions, .components = 1},
      {.size = sizeof *twins, .name = "heat", .values = positions, .components = 1}};
  PARTICLES(REQUEST, "another attribute is called \"heat\"", .attributes = twins, .attribute_count = 2);
  // All are left out, or all lie in one place.
  static float nowhere[COUNT][3];
  MeniscusParticles same = particles_of(nowhere);
  REFUSED(INPUT, "spacing", meniscus_reconstruct(&same, NULL, &mesh));
  memset(nowhere, 0xff, sizeof nowhere);
  MeniscusOptions skip = {.size = sizeof skip, .spacing = 1, .skip_invalid = 1};
  REFUSED(INPUT, "no particles", meniscus_reconstruct(&same, &skip, &mesh));
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
    refused(status, MENISCUS_STATUS_##kind, message, NULL, __LINE__);                                          \
  } while (0)
  WRITE(REQUEST, "exists already", meniscus_mesh_write(made, path, 0, NULL));
  WRITE(REQUEST, "path is NULL", meniscus_mesh_write(made, NULL, 0, NULL));
  WRITE(REQUEST, "mesh is NULL", meniscus_mesh_write(NULL, path, 0, NULL));
  WRITE(REQUEST, "mesh.doc", meniscus_mesh_write(made, "mesh.doc", 0, NULL));
  WRITE(OUTPUT, "none/mesh.ply", meniscus_mesh_write(made, "there/is/none/mesh.ply", 0, NULL));
  WRITE(REQUEST, "exists already", meniscus_check_output(path, NULL, 0));
  OK(meniscus_check_output(path, NULL, 1));
  WRITE(REQUEST, ".obj cannot hold options.attributes",
        meniscus_check_output("new.obj", &(MeniscusOptions){.size = sizeof(MeniscusOptions), .attributes = heat, .attribute_count = 1}, 0));
  OK(meniscus_check_output("new.obj", NULL, 0));
  CHECK(access("new.obj", F_OK) != 0);
  char text[8] = "1234567";
  size_t length = 9;
  OK(meniscus_mesh_format_warnings(made, "a.ply", text, sizeof text, &length));
  CHECK(length == 0 && *text == 0);
  WRITE(REQUEST, "a.txt: meshes are", meniscus_mesh_format_warnings(made, "a.txt", text, sizeof text, &length));

  float number;
  uint64_t wide;
  WRITE(REQUEST, "out is NULL", meniscus_mesh_positions_f32(made, NULL, UINT64_MAX));
  WRITE(REQUEST, "out holds 1 numbers", meniscus_mesh_positions_f32(made, &number, 1));
  WRITE(REQUEST, "out holds 1 numbers", meniscus_mesh_triangles_u64(made, &wide, 1));
  WRITE(REQUEST, "out is not aligned to 8 bytes", meniscus_mesh_triangles_u64(made, (void *)((char *)&wide + 1), 1 << 30));
  WRITE(REQUEST, "no normals", meniscus_mesh_normals(made, &number, 1));
  WRITE(REQUEST, "attribute number 0 of a mesh that has 0", meniscus_mesh_attribute(made, 0, &number, 1));
  WRITE(REQUEST, "mesh is NULL", meniscus_mesh_normals(NULL, &number, 1));
  WRITE(REQUEST, "arrays is NULL", meniscus_mesh_arrays(made, NULL));
  MeniscusArrays arrays = {.size = 3};
  WRITE(REQUEST, "arrays: its size is 3;", meniscus_mesh_arrays(made, &arrays));
  WRITE(REQUEST, "report is NULL", meniscus_mesh_report(made, NULL));
  WRITE(REQUEST, "check is NULL", meniscus_mesh_check(made, NULL));
  WRITE(REQUEST, "mesh is NULL", meniscus_reconstruct(&water, NULL, NULL));
  meniscus_mesh_free(made);

  REFUSED(REQUEST, "frame is NULL", meniscus_frame_surface(NULL, NULL, &mesh));
  WRITE(REQUEST, "frame is NULL", meniscus_frame_pack(NULL, "a.mnf", 0, NULL));
  REFUSED(REQUEST, "simulation is NULL", meniscus_simulation_frame(NULL, &water, &mesh));
  MeniscusFrame *frame;
  OK(meniscus_sample(&water, NULL, &frame));
  WRITE(REQUEST, "a.ply: packed frames are .mnf files", meniscus_frame_pack(frame, "a.ply", 0, NULL));
  meniscus_frame_free(frame);
  MeniscusOptions kernels = {.size = sizeof kernels, .method = MENISCUS_METHOD_ZHU_BRIDSON};
  OK(meniscus_sample(&water, &kernels, &frame));
  WRITE(REQUEST, "options.method needs the particles", meniscus_frame_pack(frame, "a.mnf", 0, NULL));
  meniscus_frame_free(frame);
  // NULL is no handle, and nothing to ask or to free.
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
  const uint64_t backwards[] = {5, 3}, zero = 0;
#define CONVERT(kind, message, ...)                                                                            \
  do {                                                                                                         \
    MeniscusConversion wrong = {.size = sizeof wrong, .inputs = inputs, .input_count = 1, .output = output, __VA_ARGS__}; \
    WRITE(kind, message, meniscus_convert(&wrong, NULL, NULL));                                                \
  } while (0)
  WRITE(REQUEST, "conversion is NULL", meniscus_convert(NULL, NULL, NULL));
  CONVERT(INPUT, "there are no frames", .start = 0);
  CONVERT(REQUEST, "conversion.input_count is 0", .input_count = 0);
  CONVERT(REQUEST, "conversion.inputs is NULL", .inputs = NULL);
  CONVERT(REQUEST, "conversion.inputs[1] is NULL", .input_count = 2);
  CONVERT(REQUEST, "conversion.output is NULL", .output = NULL);
  CONVERT(REQUEST, "one file for all frames", .output = "one.ply");
  CONVERT(REQUEST, "there are no frames from 4 to 0", .start = 4, .end = &zero);
  CONVERT(REQUEST, "conversion.frames: there are none from 5 to 3", .frames = backwards);
  CONVERT(REQUEST, "fps must be", .fps = -1);
  CONVERT(REQUEST, "fps must be", .fps = NAN);
  CONVERT(REQUEST, "watch must be a number of seconds", .watch = NAN);
  CONVERT(REQUEST, "conversion: its size is 2;", .size = 2);
  MeniscusSummary summary = {.size = 5};
  MeniscusConversion right = {.size = sizeof right, .inputs = inputs, .input_count = 1, .output = output};
  WRITE(REQUEST, "summary: its size is 5;", meniscus_convert(&right, NULL, &summary));
}

static int test(int count, char **arguments) {
  CHECK(count == 2);
  pour(positions, 0);
  options_are_refused();
  particles_are_refused();
  files_are_refused(arguments[1]);
  conversions_are_refused(arguments[1]);
  puts("refused, each with what and where");
  return 0;
}
