// Tests that the C++ wrapper frees memory, throws exceptions and returns correct views of arrays.
// Usage: `wrapper FOLDER`
#include <meniscus.hpp>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <thread>

#define CHECK(what)                                                            \
  do {                                                                         \
    if (!(what)) {                                                             \
      std::fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #what);          \
      std::exit(1);                                                            \
    }                                                                          \
  } while (0)

template <class Call>
static MeniscusStatus failure(Call call, const char *message) {
  try {
    call();
  } catch (const meniscus::Error &error) {
    CHECK(std::string(error.what()).find(message) != std::string::npos);
    return error.status;
  }
  return MENISCUS_STATUS_OK;
}

static void test(const std::string &folder) {
  std::vector<std::array<double, 3>> water;
  std::vector<float> speeds;
  for (int i = 0; i < 512; i++) {
    water.push_back({0.1 * (i % 8), 0.1 * (i / 8 % 8), 0.1 * (i / 64) + 0.01 * (i % 3)});
    speeds.push_back(2);
  }
  auto options =
      meniscus::Options().set("spacing", 0.1).set("normals", true).set("attributes", "speed");
  options.set("origin", {0, 0, 0}).set("threads", 1).set("up", std::string("y"));
  int calls = 0;
  options.on_progress([&](const MeniscusProgress &) { return ++calls > 0; });
  auto particles = meniscus::Particles(water).attribute("speed", speeds.data(), 1);
  const meniscus::Mesh mesh = meniscus::reconstruct(particles, options);
  CHECK(calls > 2 && mesh.vertex_count() > 100 && mesh.checked().is_closed_oriented_manifold);
  CHECK(mesh.positions().size() == 3 * mesh.vertex_count() && mesh.normals().size() == mesh.positions().size());
  const auto copied = mesh.copy_positions<float>();
  for (std::size_t i = 0; i < copied.size(); i++) CHECK(copied[i] == static_cast<float>(mesh.positions()[i]));
  CHECK(mesh.copy_positions<double>()[5] == mesh.positions()[5]);
  CHECK(mesh.copy_triangles()[7] == mesh.triangles()[7]);
  for (float speed : mesh.attribute("speed")) CHECK(std::abs(speed - 2) < 1e-6f);
  // Integers that float cannot represent exactly.
  std::vector<int32_t> ids;
  for (int i = 0; i < 512; i++) ids.push_back(16777217 + 2 * i);
  const auto numbered = meniscus::Particles(water).attribute("id", ids.data(), 1);
  const auto by_id = meniscus::Options().set("spacing", 0.1).set("attributes", "id");
  const auto whole = meniscus::reconstruct(numbered, by_id).copy_whole("id");
  CHECK(whole.size() == mesh.vertex_count());
  for (int64_t id : whole) CHECK(id >= ids.front() && id <= ids.back() && id % 2 == 1);
  bool missing = false;
  try {
    mesh.attribute("heat");
  } catch (const std::out_of_range &) {
    missing = true;
  }
  CHECK(missing && mesh.report().particles == 512 && mesh.warnings().empty());
  const std::string path = folder + "/wrapped.ply";
  CHECK(mesh.overwrite(path) > 1000);
  CHECK(failure([&] { mesh.write(path); }, "already exists") == MENISCUS_STATUS_REQUEST);

  // A callback can cancel by returning false, and its exceptions reach the caller.
  options.on_progress([](const MeniscusProgress &) { return false; });
  CHECK(failure([&] { meniscus::reconstruct(particles, options); }, "cancelled") == MENISCUS_STATUS_CANCELLED);
  options.on_progress([](const MeniscusProgress &) -> bool { throw 42; });
  int caught = 0;
  try {
    meniscus::reconstruct(particles, options);
  } catch (int thrown) {
    caught = thrown;
  }
  CHECK(caught == 42);
  options.on_progress(nullptr);
  options.set("spacing", -1);
  const auto refused = [](auto call, const char *message) {
    CHECK(failure(call, message) == MENISCUS_STATUS_REQUEST);
  };
  refused([&] { meniscus::reconstruct(particles, options); },
          "spacing must be positive and finite, got -1");
  refused([&] { options.set("spacng", 1); }, "no option has the key \"spacng\"");
  refused([&] { options.set("normals", "yes"); }, "normals: expected true or false, got \"yes\"");
  refused([&] { options.set("origin", std::vector<double>{1}); }, "origin: expected 3 numbers");
  CHECK(failure([&] { meniscus::reconstruct("none.bgeo"); }, "none.bgeo") == MENISCUS_STATUS_INPUT);
  meniscus::Cancel cancel;
  options.set("spacing", 0.1).clear("origin");
  auto cancelled = options;
  cancelled.cancel_by(cancel);
  cancel.cancel();
  const auto by_cancelled = [&] { meniscus::reconstruct(particles, cancelled); };
  CHECK(failure(by_cancelled, "cancelled") == MENISCUS_STATUS_CANCELLED);
  cancelled = options;
  CHECK(meniscus::reconstruct(particles, cancelled).vertex_count() == mesh.vertex_count());

  const meniscus::Frame frame(particles, options);
  const auto calm = meniscus::Options().set("smooth", 2).set("attributes", "speed");
  CHECK(frame.surface(calm).triangle_count() != frame.surface().triangle_count());
  meniscus::Simulation simulation(options);
  CHECK(simulation.frame(particles).vertex_count() > 100);
  meniscus::Simulation moved = std::move(simulation);
  CHECK(moved.frame(particles).vertex_count() > 100);
}

int main(int count, char **arguments) {
  CHECK(count == 2);
  std::thread([&] { test(arguments[1]); }).join();
  std::puts("the C++ wrapper works");
}
