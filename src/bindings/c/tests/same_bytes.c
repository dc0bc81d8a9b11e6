// Checks that the library writes the same bytes as the program for the same input and options:
// `same_bytes PROGRAM FOLDER`.
#include "water.h"

#include <stdarg.h>

static const char *program, *folder;

static void run(const char *format, ...) {
  char command[4096];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(command, sizeof command, format, arguments);
  va_end(arguments);
  int code = system(command);
  if (code != 0) {
    fprintf(stderr, "%s: %d\n", command, code);
    exit(1);
  }
}

/// Compares the files of the program and of the library: the mesh, and the files that the mesh
/// refers to.
static void compare(const char *extension, const MeniscusMesh *mesh, const char *input, const char *options) {
  char path[512];
  run("rm -rf %s/program %s/library && mkdir %s/program %s/library", folder, folder, folder, folder);
  run("%s reconstruct %s -o %s/program/mesh.%s --quiet --backend cpu %s", program, input, folder, extension, options);
  snprintf(path, sizeof path, "%s/library/mesh.%s", folder, extension);
  uint64_t bytes = 0;
  OK(meniscus_mesh_write(mesh, path, 0, &bytes));
  CHECK(bytes > 0);
  run("diff -r %s/program %s/library", folder, folder);
}

static void save(const char *name, const char *head, size_t head_bytes, const void *values, size_t bytes) {
  char path[512];
  snprintf(path, sizeof path, "%s/%s", folder, name);
  FILE *file = fopen(path, "wb");
  CHECK(file && fwrite(head, 1, head_bytes, file) == head_bytes && fwrite(values, 1, bytes, file) == bytes);
  CHECK(fclose(file) == 0);
}

static int test(int count, char **arguments) {
  CHECK(count == 3);
  program = arguments[1], folder = arguments[2];
  static float positions[COUNT][3];
  static double wide[COUNT][3];
  static struct { double mass; float velocity[3]; float pad; double at[3]; } structures[COUNT];
  pour(positions, 0);
  for (int i = 0; i < COUNT; i++) {
    structures[i].velocity[1] = (float)i;
    for (int axis = 0; axis < 3; axis++) {
      // Add digits that fit into a double but not into a float, so that rounding is noticed.
      structures[i].at[axis] = wide[i][axis] = positions[i][axis] + 1e-9 * i;
    }
  }
  char narrow_file[512], wide_file[512];
  snprintf(narrow_file, sizeof narrow_file, "%s/water.xyz", folder);
  snprintf(wide_file, sizeof wide_file, "%s/water.npy", folder);
  save("water.xyz", "", 0, positions, sizeof positions);
  char head[128] = "\x93NUMPY\1\0\x76\0{'descr': '<f8', 'fortran_order': False, 'shape': (1005, 3), }";
  size_t used = 10 + strlen(head + 10);
  memset(head + used, ' ', sizeof head - used);
  head[127] = '\n';
  CHECK(COUNT == 1005);
  save("water.npy", head, sizeof head, wide, sizeof wide);

  // Test every mesh format with 32-bit and 64-bit positions, in memory and in a file.
  const char *formats[] = {"ply", "obj", "vtk", "vtp", "pvtp", "vtkhdf", "stl", "usdc", "glb", "abc"};
  MeniscusParticles narrow = particles_of(positions);
  MeniscusParticles doubles = {
      .size = sizeof doubles, .count = COUNT, .positions = wide, .number = MENISCUS_TYPE_F64};
  MeniscusMesh *of_narrow, *of_wide, *of_file;
  OK(meniscus_reconstruct(&narrow, NULL, &of_narrow));
  OK(meniscus_reconstruct(&doubles, NULL, &of_wide));
  OK(meniscus_reconstruct_file(wide_file, NULL, &of_file));
  for (size_t i = 0; i < sizeof formats / sizeof *formats; i++) {
    compare(formats[i], of_narrow, narrow_file, "");
    compare(formats[i], of_wide, wide_file, "");
    compare(formats[i], of_file, wide_file, "");
  }
  meniscus_mesh_free(of_narrow);
  meniscus_mesh_free(of_wide);
  meniscus_mesh_free(of_file);

  // Test many options, with positions inside structures that also contain other numbers.
  struct { const char *flags; const char *const options[9]; } all[] = {
      {"--spacing 0.05 --cell 0.3 --smooth 2", {"spacing", "0.05", "cell", "0.3", "smooth", "2"}},
      {"--radius 0.025 --cell-size 0.03 --normals",
       {"radius", "0.025", "cell-size", "0.03", "normals", "true"}},
      {"--indicator counting --detail --sigma 1.5",
       {"indicator", "counting", "detail", "true", "sigma", "1.5"}},
      {"--indicator counting --mu0 0.3 --cell 0.7",
       {"indicator", "counting", "mu0", "0.3", "cell", "0.7"}},
      {"--indicator symmetry --iso 0.2 --cell 1 --origin 0.01,0,0",
       {"indicator", "symmetry", "iso", "0.2", "cell", "1", "origin", "0.01,0,0"}},
      {"--domain -0.02,-,-,0.4,-,- --simplify 0.5",
       {"domain", "-0.02,-,-,0.4,-,-", "simplify", "0.5"}},
      {"--periodic -0.3,-,-0.3,0.95,-,0.95 --periodic-mesh overlap",
       {"periodic", "-0.3 - -0.3 0.95 - 0.95", "periodic-mesh", "overlap"}},
      {"--method mueller", {"method", "mueller"}},
      {"--method zhu-bridson", {"method", "zhu-bridson"}},
      {"--method yu-turk --iso 0.4", {"method", "yu-turk", "iso", "0.4"}},
      {"--memory 24MiB --threads 1 --smallest-drop 5",
       {"memory", "24MiB", "threads", "1", "smallest-drop", "5"}},
      {"--smallest-component 20 --up z --skip-invalid",
       {"smallest-component", "20", "up", "z", "skip-invalid", "true"}},
  };
  MeniscusParticles strided = {.size = sizeof strided,
                               .count = COUNT,
                               .positions = structures[0].at,
                               .stride = sizeof *structures,
                               .number = MENISCUS_TYPE_F64};
  for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
    MeniscusMesh *mesh;
    MeniscusOptions *options = options_of(all[i].options);
    OK(meniscus_reconstruct(&strided, options, &mesh));
    meniscus_options_free(options);
    compare("ply", mesh, wide_file, all[i].flags);
    meniscus_mesh_free(mesh);
  }
  MeniscusOptions *small = OPTIONS("compress", "true", "particles-up", "z");
  MeniscusMesh *mesh;
  OK(meniscus_reconstruct(&strided, small, &mesh));
  meniscus_options_free(small);
  compare("glb", mesh, wide_file, "--compress --particles-up z");
  meniscus_mesh_free(mesh);

  // A Vulkan device gives the same bytes as the CPU.
  MeniscusOptions *device = OPTIONS("backend", "vulkan", "normals", "true");
  MeniscusStatus status = meniscus_reconstruct(&strided, device, &mesh);
  meniscus_options_free(device);
  driver_used = true;
  if (status == MENISCUS_STATUS_DEVICE && !getenv("MENISCUS_REQUIRE_VULKAN")) {
    printf("without a Vulkan device: %s\n", meniscus_last_error());
  } else {
    OK(status);
    compare("ply", mesh, wide_file, "--normals");
    meniscus_mesh_free(mesh);
  }

  // A packed frame must have the same bytes as the program's packed frame, and the mesh of the
  // packed frame must also have the same bytes.
  char packed[512];
  snprintf(packed, sizeof packed, "%s/library.mnf", folder);
  MeniscusFrame *frame;
  OK(meniscus_sample_file(wide_file, NULL, &frame));
  OK(meniscus_frame_pack(frame, packed, 1, NULL));
  meniscus_frame_free(frame);
  run("%s pack %s -o %s/program.mnf --quiet --backend cpu --overwrite", program, wide_file, folder);
  run("cmp %s/program.mnf %s", folder, packed);
  MeniscusOptions *calm = OPTIONS("smooth", "2");
  OK(meniscus_reconstruct_file(packed, calm, &mesh));
  meniscus_options_free(calm);
  compare("ply", mesh, wide_file, "--smooth 2");
  meniscus_mesh_free(mesh);

  // Convert a simulation with the program and with the library: all files must be equal, except for
  // the times in them.
  run("rm -rf %s/frames %s/by_*; mkdir %s/frames", folder, folder, folder);
  for (int number = 1; number <= 3; number++) {
    char name[64];
    pour(positions, 0.01f * (float)number);
    snprintf(name, sizeof name, "frames/water_%d.xyz", number);
    save(name, "", 0, positions, sizeof positions);
  }
  char frames[512], meshes[512];
  snprintf(frames, sizeof frames, "%s/frames", folder);
  snprintf(meshes, sizeof meshes, "%s/by_library/mesh_{:04}.vtp", folder);
  const char *inputs[] = {frames};
  MeniscusOptions *options = OPTIONS("start", "1", "end", "3", "step", "2", "fps", "25");
  MeniscusSummary summary = {.size = sizeof summary};
  OK(meniscus_convert(inputs, 1, meshes, options, &summary));
  meniscus_options_free(options);
  CHECK(summary.made == 2 && summary.failed == 0 && summary.missing == 0 && summary.particles == 2 * COUNT);
  run("%s reconstruct %s -o '%s/by_program/mesh_{:04}.vtp' --start 1 --end 3 --step 2 --fps 25 --quiet --backend cpu",
      program, frames, folder);
  run("cd %s/by_library && for file in *.vtp *.pvd *.series *.json; do cmp $file ../by_program/$file; done", folder);
  puts("same bytes as the program");
  return 0;
}
