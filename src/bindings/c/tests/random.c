// Calls the library with random arguments, valid and invalid, in random order. Checks that no call
// crashes, that every failure has a code and a message, and that meshes are closed. `random FOLDER
// CALLS SEED` prints the number of calls for each code. If FUZZED is defined, this is the target
// `c` of `tools/fuzz`: a function whose bytes determine the calls and their arguments.
#include "water.h"

#include <time.h>

#ifdef FUZZED
static const unsigned char *fuzz_bytes, *fuzz_end;

static bool more_to_pick(void) {
  return fuzz_bytes < fuzz_end;
}

/// A number below `among`, made from the fuzzer's next bytes. When all bytes are used up, the
/// number is always `among - 1`, which never selects a rare case.
static uint32_t pick(uint32_t among) {
  uint32_t number = 0;
  for (uint32_t most = among - 1; among > 0 && most > 0; most >>= 8) {
    if (!more_to_pick()) return among - 1;
    number = number << 8 | *fuzz_bytes++;
  }
  return among > 0 ? number % among : 0;
}
#else
static uint64_t state;

static bool more_to_pick(void) {
  return true;
}

/// A random number below `among`.
static uint32_t pick(uint32_t among) {
  return (uint32_t)(next(&state) * among);
}
#endif

/// A number from 0 to 1.
static double share(void) {
  return pick(256) / 256.0;
}

/// True with a probability of 1 / `times`.
static bool rarely(uint32_t times) {
  return pick(times) == 0;
}

/// A number near `usual`, or sometimes an extreme number.
static double number(double usual) {
  const double odd[] = {0, -1, 1, NAN, INFINITY, -INFINITY, 1e-300, 1e300, -0.0, 5e-324, 1e15, 0.5, 1e-9, 3, 65536};
  return rarely(3) ? odd[pick(sizeof odd / sizeof *odd)] : usual * (0.5 + share());
}

static size_t random_size(size_t right) {
  const size_t odd[] = {0, 1, 7, 9, 4097, SIZE_MAX, 8};
  return rarely(20) ? odd[pick(7)] : rarely(12) ? 8 * (1 + pick((uint32_t)right / 8)) : right;
}

#ifdef FUZZED
// Use few particles, so that a fuzzing run can make many calls.
enum { MOST = 30 };
static const double EXTENT = 0.12;
#else
enum { MOST = 200 };
static const double EXTENT = 0.4;
#endif

// The particles' data. The block is exactly as large as the structures state, so that valgrind
// detects reads beyond the end of the block.
static unsigned char *memory;
static MeniscusAttribute attributes[3];
static const char *words[] = {"velocity", "heat", "v", "none", "", "\xff\xfe", "a very long name of an attribute, as nobody has", NULL};

static unsigned char *allocate(size_t bytes) {
  free(memory);
  memory = calloc(bytes ? bytes : 1, 1);
  CHECK(memory);
  return memory;
}

static void put(unsigned char *at, int32_t type, double wide) {
  float narrow = (float)wide;
  memcpy(at, type == MENISCUS_TYPE_F32 ? (void *)&narrow : (void *)&wide, type == MENISCUS_TYPE_F32 ? 4 : 8);
}

/// Random particles in `memory`, or sometimes invalid ones that the library must reject.
static MeniscusParticles *some_particles(MeniscusParticles *particles) {
  memset(particles, 0, sizeof *particles);
  int32_t type = (int32_t)pick(2);
  size_t width = type == 0 ? 4 : 8, gap = rarely(3) ? pick(9) : 0, step = 3 * width + gap;
  size_t count = rarely(15) ? 0 : rarely(4) ? 1 + pick(6) : 1 + pick(MOST);
  double spread = rarely(8) ? 0 : EXTENT;
  unsigned char *at = allocate(count * step);
  particles->size = random_size(sizeof *particles);
  particles->count = count;
  particles->positions = at;
  particles->number = type;
  particles->stride = gap ? (ptrdiff_t)step : 0;
  if (count > 0 && rarely(6)) {
    particles->positions = at + (count - 1) * step, particles->stride = -(ptrdiff_t)step;
  }
  if (count > 0 && rarely(8)) {
    particles->positions = at, particles->stride = (ptrdiff_t)width, particles->component_stride = (ptrdiff_t)(count * width);
  }
  // If the caller passes the smaller structure of an older header, the library assumes strides of
  // 0.
  if (particles->size != sizeof *particles) {
    particles->positions = at, particles->stride = particles->component_stride = 0;
  }
  uint64_t seed = pick(1 << 16);
  size_t odd = rarely(10) && count > 0 ? pick((uint32_t)(3 * count)) : SIZE_MAX;
  for (size_t i = 0; i < 3 * count; i++) {
    unsigned char *first = (unsigned char *)particles->positions;
    ptrdiff_t stride = particles->stride ? particles->stride : (ptrdiff_t)(3 * width);
    ptrdiff_t component_stride = particles->component_stride ? particles->component_stride : (ptrdiff_t)width;
    double coordinate = i == odd ? number(1) : spread * next(&seed);
    put(first + (ptrdiff_t)(i / 3) * stride + (ptrdiff_t)(i % 3) * component_stride, type, coordinate);
  }
  if (particles->size == sizeof *particles && rarely(6)) {
    particles->attributes = attributes;
    particles->attribute_count = pick(4);
    for (int i = 0; i < 3; i++) {
      MeniscusAttribute *one = &attributes[i];
      memset(one, 0, sizeof *one);
      one->size = rarely(40) ? random_size(sizeof *one) : sizeof *one;
      one->name = words[rarely(6) ? pick(8) : (uint32_t)i];
      one->values = rarely(15) ? NULL : particles->positions;
      one->components = rarely(12) ? pick(5) * 65535u : 1 + pick(3);
      // The attribute's values are the bytes of the positions. If the coordinates have 4 bytes, the
      // attribute can have any type of 4 bytes.
      one->number = type == MENISCUS_TYPE_F32 && rarely(3) ? MENISCUS_TYPE_I32 + (int32_t)pick(2) : type;
      one->stride = particles->stride, one->component_stride = particles->component_stride;
      if (one->components > 3 && one->components <= 65536) {
        one->stride = one->component_stride = 0, one->values = NULL;
      }
    }
    // The size field of a structure is also the stride of the array. If a size is wrong, the library
    // would read the next structure at a wrong address, so allow only one attribute.
    if (attributes[0].size != sizeof *attributes || attributes[1].size != sizeof *attributes) {
      particles->attribute_count = particles->attribute_count > 0;
    }
  }
  if (particles->size == sizeof *particles && rarely(25)) {
    // The library must reject these strides before it reads a position.
    const ptrdiff_t far[] = {PTRDIFF_MAX, PTRDIFF_MIN, PTRDIFF_MAX / 2};
    particles->count = count + 4, particles->stride = far[pick(3)];
  }
  if (rarely(40)) particles->count = UINT64_MAX >> pick(3);
  if (rarely(40)) particles->positions = NULL;
  if (rarely(30)) particles->number = rarely(2) ? -1 : 4 + (int32_t)pick(77);
  return rarely(60) ? NULL : particles;
}

static int32_t cancel_at_countdown(void *user, const MeniscusProgress *progress) {
  CHECK(progress->done >= 0 && progress->done <= 1);
  // Cancel when the counter in `user` reaches 0.
  return user && --*(int *)user == 0;
}

static int calls_until_cancel;
static MeniscusCancel *cancel;

/// Checks the result of a call that sets an option: success, or an error with a message.
static void check_option_status(MeniscusStatus status) {
  CHECK(status == MENISCUS_STATUS_OK || status == MENISCUS_STATUS_REQUEST);
  CHECK(status == MENISCUS_STATUS_OK || strlen(meniscus_last_error()) > 5);
}

static void set(MeniscusOptions *options, const char *key, const char *value) {
  check_option_status(meniscus_options_set(options, key, value));
}

static void set_numbers(MeniscusOptions *options, const char *key, const double *values,
                        size_t count) {
  check_option_status(meniscus_options_set_numbers(options, key, values, count));
}

static void set_number(MeniscusOptions *options, const char *key, double value) {
  check_option_status(meniscus_options_set_number(options, key, value));
}

static void set_box(MeniscusOptions *options, const char *key) {
  double box[6];
  for (int i = 0; i < 6; i++) {
    const double open = i < 3 ? -INFINITY : INFINITY, usual = (i < 3 ? -0.2 : 0.7) + 0.1 * share();
    box[i] = rarely(12) ? number(1) : rarely(6) ? open : usual;
  }
  if (rarely(4)) set_numbers(options, key, box, 6);
}

/// Whether an option may be set to random values. Random values of the other options would start a
/// slow search for devices, wait for frames that never appear, write to other folders, or start too
/// many threads.
static bool is_harmless(const char *key) {
  const char *harmful[] = {"backend", "device", "watch", "scratch", "threads"};
  for (size_t i = 0; i < sizeof harmful / sizeof *harmful; i++) {
    if (strcmp(key, harmful[i]) == 0) return false;
  }
  return true;
}

/// Sets any option to any value.
static void set_anything(MeniscusOptions *options) {
  const char *odd[] = {
      "",     "0",    "1", "-1", "nan", "1e999", "true",        "false",       "auto",
      "none", "y",    "z", ",",  "1,2", "1 2 3", "-,-,-,-,-,-", "0,-,0,1,-,1", "velocity,heat",
      "3..5", "5..3", "5", "\xff", NULL,  "1KiB",  "18446744073709551616",
  };
  double numbers[7];
  const char *key = rarely(10) ? words[pick(8)] : meniscus_options_key(pick(60));
  if (key && !is_harmless(key)) return;
  if (rarely(3)) {
    for (int i = 0; i < 7; i++) numbers[i] = number(1);
    set_numbers(rarely(50) ? NULL : options, key, numbers, pick(8));
  } else {
    set(rarely(50) ? NULL : options, key, odd[pick(sizeof odd / sizeof *odd)]);
  }
}

/// Options with valid and invalid values, which the caller must free.
static MeniscusOptions *some_options(const char *folder) {
  MeniscusOptions *options = rarely(20) ? meniscus_options_copy(NULL) : meniscus_options_new();
  set_number(options, "spacing", rarely(2) ? 0.05 : rarely(8) ? number(0.05) : 0.05);
  if (rarely(12)) {
    set_number(options, "radius", number(0.03));
    if (!rarely(4)) set(options, "spacing", NULL);
  }
  if (rarely(10)) set_number(options, "cell-size", number(0.04));
  if (rarely(4)) set_number(options, "cell", number(0.7));
  if (rarely(12)) set_numbers(options, "origin", (double[]){number(0.1), number(1), 0}, 3);
  if (rarely(2)) set_box(options, "domain");
  if (rarely(4)) set_box(options, "periodic");
  if (rarely(20)) set(options, "where", words[pick(8)]);
  if (rarely(12)) set_number(options, "mu0", number(1));
  if (rarely(5)) set_number(options, "smooth", number(1.5));
  if (rarely(12)) set_number(options, "sigma", number(1.5));
  if (rarely(12)) set_number(options, "iso", number(0.4));
  if (rarely(8)) set_number(options, "simplify", number(0.5));
  if (rarely(10)) set_number(options, "smallest-component", number(5));
  if (rarely(10)) set_number(options, "smallest-drop", pick(9));
  const char *usual = rarely(2) ? "velocity" : "none";
  if (rarely(6)) set(options, "attributes", rarely(4) ? words[pick(8)] : usual);
  const uint64_t budget = rarely(8) ? (uint64_t)fabs(number(1 << 20)) % (1u << 30) : 200 << 20;
  set_number(options, "memory", (double)budget);
  if (rarely(20)) set(options, "scratch", rarely(2) ? folder : "there/is/none");
  if (rarely(30)) {
    const bool is_cpu = rarely(2);
    set(options, "backend", is_cpu ? "cpu" : "auto");
    if (rarely(2)) set(options, "device", is_cpu ? "none" : NULL);
  }
  if (rarely(6)) {
    OK(meniscus_options_on_progress(options, cancel_at_countdown, &calls_until_cancel));
    calls_until_cancel = (int)pick(12);
  }
  if (rarely(15)) {
    OK(meniscus_options_cancel_by(options, cancel));
    if (rarely(3)) meniscus_cancel(cancel);
  }
  set_number(options, "threads", rarely(50) ? 5000 : 1 + rarely(40));
  if (rarely(3)) {
    const char *indicators[] = {"cloud", "counting", "symmetry", "none"};
    const char *methods[] = {"dif", "mueller", "zhu-bridson", "yu-turk"};
    set(options, "indicator", rarely(2) ? NULL : indicators[pick(4)]);
    if (rarely(2)) set(options, "method", methods[pick(4)]);
    if (rarely(2)) set(options, "periodic-mesh", rarely(2) ? "cut" : "overlap");
    if (rarely(2)) set(options, "up", rarely(2) ? "y" : "z");
    if (rarely(2)) set(options, "particles-up", rarely(2) ? "y" : "z");
    set_number(options, "skip-invalid", rarely(2)), set_number(options, "detail", rarely(4));
    set_number(options, "normals", rarely(2)), set_number(options, "compress", rarely(4));
  }
  if (rarely(4)) set_anything(options);
  if (!rarely(30)) return options;
  meniscus_options_free(options);
  return NULL;
}

static uint64_t codes[256], calls;

static MeniscusStatus count_status(MeniscusStatus status) {
  calls++;
  CHECK(status >= 0 && status < 256 && status != MENISCUS_STATUS_INTERNAL);
  CHECK(status == MENISCUS_STATUS_OK || strlen(meniscus_last_error()) > 5);
  codes[status]++;
  return status;
}

/// Makes a random query about a mesh.
static void random_query(const MeniscusMesh *mesh, const char *folder) {
  uint64_t vertices = meniscus_mesh_vertex_count(mesh), triangles = meniscus_mesh_triangle_count(mesh);
  uint64_t room = rarely(4) ? pick(100) : 3 * (vertices > triangles ? vertices : triangles);
  void *out = rarely(10) ? NULL : malloc(8 * room + 1);
  size_t index = pick(3), length = 0;
  MeniscusArrays arrays = {.size = random_size(sizeof arrays)};
  MeniscusReport report = {.size = random_size(sizeof report)};
  MeniscusCheck check = {.size = random_size(sizeof check)};
  // The library writes as many bytes as the size field states, so the size field must not exceed
  // the structure.
  if (arrays.size > sizeof arrays && arrays.size <= 4096) arrays.size = 8;
  if (report.size > sizeof report && report.size <= 4096) report.size = 8;
  if (check.size > sizeof check && check.size <= 4096) check.size = 8;
  char path[512], text[40];
  const char *ends[] = {"ply", "obj", "stl", "glb", "usdc", "vtp", "doc", "vtkhdf"};
  snprintf(path, sizeof path, "%s%s/random.%s", folder, rarely(20) ? "/none" : "", ends[pick(8)]);
  switch (pick(14)) {
    case 0: count_status(meniscus_mesh_positions_f32(mesh, out, room)); break;
    case 1: count_status(meniscus_mesh_positions_f64(mesh, out, room)); break;
    case 2: count_status(meniscus_mesh_triangles_u32(mesh, out, room)); break;
    case 3: count_status(meniscus_mesh_triangles_u64(mesh, out, room)); break;
    case 4: count_status(meniscus_mesh_normals(mesh, out, room)); break;
    case 5: {
      uint64_t components = meniscus_mesh_attribute_components(mesh, index);
      bool fits = components <= 3;
      if (meniscus_mesh_attribute_is_whole(mesh, index) && rarely(2)) {
        count_status(meniscus_mesh_attribute_whole(mesh, index, fits ? out : NULL, room));
      } else {
        count_status(meniscus_mesh_attribute(mesh, index, fits ? out : NULL, room));
      }
      break;
    }
    case 6:
      if (count_status(meniscus_mesh_arrays(mesh, rarely(20) ? NULL : &arrays)) == 0 && arrays.size >= sizeof arrays) {
        for (uint64_t i = 0; i < 3 * arrays.triangle_count; i++) CHECK(arrays.triangles[i] < arrays.vertex_count);
        for (uint64_t i = 0; i < 3 * arrays.vertex_count; i++) CHECK(isfinite(arrays.positions[i]));
      }
      break;
    case 7: count_status(meniscus_mesh_report(mesh, rarely(20) ? NULL : &report)); break;
    case 8:
      if (count_status(meniscus_mesh_check(mesh, rarely(20) ? NULL : &check)) == 0 && check.size == sizeof check) {
        CHECK(check.is_closed_oriented_manifold);
      }
      break;
    case 9: count_status(meniscus_mesh_write(mesh, rarely(20) ? NULL : path, (int32_t)pick(3), rarely(2) ? NULL : &room)); break;
    case 10: count_status(meniscus_mesh_format_warnings(mesh, path, rarely(3) ? NULL : text, pick(sizeof text), rarely(3) ? NULL : &length)); break;
    case 11: calls++, (void)meniscus_mesh_attribute_name(mesh, index), (void)meniscus_mesh_has_normals(mesh); break;
    case 12: calls++, (void)meniscus_mesh_warning(mesh, index), (void)meniscus_mesh_warning_count(mesh); break;
    default: count_status(meniscus_check_output(rarely(20) ? NULL : path, NULL, (int32_t)pick(2))); break;
  }
  free(out);
}

/// Writes three small frames for conversions, and returns their name with {} for the number.
static const char *frames_in(const char *folder) {
  static char name[512];
  char path[512];
  for (int frame = 0; frame < 3; frame++) {
    snprintf(path, sizeof path, "%s/frame_%d.csv", folder, frame);
    FILE *file = fopen(path, "w");
    CHECK(file && fputs("x,y,z\n", file) >= 0);
    for (int i = 0; i < 27; i++) CHECK(fprintf(file, "%g,%g,%g\n", i % 3 * SPACING, i / 3 % 3 * SPACING, i / 9 * SPACING) > 0);
    CHECK(fclose(file) == 0);
  }
  snprintf(name, sizeof name, "%s/frame_{}.csv", folder);
  return name;
}

static int32_t cancel_at_event(void *user, const MeniscusEvent *event) {
  CHECK(strlen(event->text) > 5);
  return user && --*(int *)user == 0;
}

static void convert(const char *folder, const char *frames) {
  const char *inputs[] = {rarely(3) ? folder : rarely(3) ? "there/is/none_{}.bgeo" : frames, rarely(3) ? NULL : folder};
  char output[512], one[512];
  snprintf(output, sizeof output, "%s/random_{}.ply", folder);
  snprintf(one, sizeof one, "%s/one.ply", folder);
  MeniscusOptions *some = some_options(folder);
  if (some) {
    char range[24];
    snprintf(range, sizeof range, "%u..%u", pick(9), pick(9));
    if (rarely(3)) set_number(some, "start", pick(9) - 2.0);
    if (rarely(9)) set_number(some, "together", 1);
    if (rarely(3)) set_number(some, "end", pick(9));
    if (rarely(3)) set(some, "frames", range);
    if (rarely(2)) set_number(some, "step", pick(3));
    if (rarely(3)) set_number(some, "fps", number(25));
    // Use only tiny or invalid timeouts, because no new frame ever appears.
    if (rarely(9)) set_number(some, "watch", rarely(2) ? 1e-9 : -fabs(number(1)));
    set_number(some, "overwrite", rarely(2)), set_number(some, "resume", rarely(2));
    if (rarely(2)) {
      OK(meniscus_options_on_event(some, cancel_at_event, &calls_until_cancel));
      calls_until_cancel = (int)pick(30);
    }
  }
  MeniscusSummary summary = {.size = sizeof summary};
  const char *to = rarely(10) ? NULL : rarely(3) ? one : output;
  const char *const *from = rarely(20) ? NULL : inputs;
  const size_t count = rarely(4) ? pick(3) : 1;
  count_status(meniscus_convert(from, count, to, some, rarely(3) ? NULL : &summary));
  meniscus_options_free(some);
}

/// Replaces a mesh with a new one, which must be closed.
static void replace_mesh(MeniscusMesh **mesh, MeniscusMesh *made) {
  MeniscusCheck check = {.size = sizeof check};
  OK(meniscus_mesh_check(made, &check));
  CHECK(check.is_closed_oriented_manifold);
  meniscus_mesh_free(*mesh), *mesh = made;
  calls += 2;
}

/// Makes `wanted` calls, or fewer if the fuzzer's bytes end.
static void make_calls(const char *folder, uint64_t wanted) {
  MeniscusMesh *mesh = NULL;
  MeniscusFrame *frame = NULL;
  MeniscusSimulation *simulation = NULL;
  MeniscusParticles particles;
  char path[512];
  snprintf(path, sizeof path, "%s/random.mnf", folder);
  const char *frames = frames_in(folder);
  cancel = meniscus_cancel_new();
  for (calls = 0; calls < wanted && more_to_pick();) {
    MeniscusMesh *made = NULL;
    MeniscusFrame *sampled = NULL;
    MeniscusSimulation *begun = NULL;
    uint32_t what = pick(100);
    MeniscusOptions *options = what < 40 ? some_options(folder) : NULL;
    if (what < 14) {
      const MeniscusParticles *some = some_particles(&particles);
      count_status(meniscus_reconstruct(some, options, rarely(60) ? NULL : &made));
    } else if (what < 20) {
      const MeniscusParticles *some = some_particles(&particles);
      count_status(meniscus_sample(some, options, &sampled));
    } else if (what < 26) {
      count_status(meniscus_frame_surface(frame, options, &made));
    } else if (what < 29) {
      count_status(meniscus_frame_pack(frame, rarely(10) ? "a.ply" : path, (int32_t)pick(2), NULL));
    } else if (what < 32) {
      count_status(meniscus_reconstruct_file(rarely(3) ? words[pick(8)] : path, options, &made));
    } else if (what < 34) {
      count_status(meniscus_sample_file(rarely(3) ? words[pick(8)] : path, options, &sampled));
    } else if (what < 40) {
      count_status(meniscus_simulation_new(options, &begun));
    } else if (what < 48) {
      count_status(meniscus_simulation_frame(simulation, some_particles(&particles), &made));
      (void)meniscus_simulation_is_settled(simulation);
    } else if (what < 51) {
      convert(folder, frames);
    } else {
      random_query(rarely(50) ? NULL : mesh, folder);
    }
    meniscus_options_free(options);
    if (made) replace_mesh(&mesh, made);
    if (sampled) meniscus_frame_free(frame), frame = sampled, calls++;
    if (begun) meniscus_simulation_free(simulation), simulation = begun, calls++;
    // Free handles in any order: a mesh must stay valid when its frame is freed.
    if (rarely(200)) meniscus_mesh_free(mesh), mesh = NULL, calls++;
    if (rarely(200)) meniscus_frame_free(frame), frame = NULL, calls++;
    if (rarely(200)) meniscus_simulation_free(simulation), simulation = NULL, calls++;
    if (rarely(30)) meniscus_cancel_free(cancel), cancel = meniscus_cancel_new(), calls += 2;
  }
  meniscus_mesh_free(mesh), meniscus_frame_free(frame), meniscus_simulation_free(simulation), meniscus_cancel_free(cancel);
  free(memory), memory = NULL;
}

#ifdef FUZZED
/// Makes the calls that `bytes` determine. `folder` is the path of an empty folder.
void meniscus_calls_of_bytes(const char *folder, const unsigned char *bytes, size_t size) {
  fuzz_bytes = bytes, fuzz_end = bytes + size;
  make_calls(folder, 40);
}
#else
static int test(int count, char **arguments) {
  CHECK(count == 4);
  const uint64_t wanted = strtoull(arguments[2], NULL, 10);
  state = strtoull(arguments[3], NULL, 10);
  time_t begun = time(NULL);
  make_calls(arguments[1], wanted);
  printf("%llu random calls in %lld s:", (unsigned long long)calls, (long long)(time(NULL) - begun));
  for (int i = 0; i < 256; i++) {
    if (codes[i]) printf(" %llu returned %d,", (unsigned long long)codes[i], i);
  }
  puts(" none crashed");
  // The test is only useful if many calls succeed and if every kind of failure occurs.
  CHECK(wanted < 2000 || (codes[0] > calls / 5 && codes[MENISCUS_STATUS_REQUEST] > calls / 20 && codes[MENISCUS_STATUS_INPUT] && codes[MENISCUS_STATUS_CANCELLED]));
  return 0;
}
#endif
