// Reconstructs the surface of a running simulation and writes one file per frame. Usage: `simulation FOLDER`
#include <meniscus.hpp>

#include <cmath>
#include <cstdio>
#include <iostream>

// A stand-in for a solver: two blocks of water that fall, bounce off the floor and lose speed.
struct Solver {
  std::vector<std::array<double, 3>> positions;
  std::vector<std::array<float, 3>> velocities;

  Solver() {
    for (int i = 0; i < 16 * 16 * 16; i++) {
      const double x = i % 16, y = i / 16 % 16, z = i / 256;
      for (double side : {0.0, 1.2}) positions.push_back({side + 0.05 * x, 0.3 + 0.05 * y, 0.05 * z});
    }
    velocities.resize(positions.size());
  }
  void step(double seconds) {
    for (std::size_t i = 0; i < positions.size(); i++) {
      auto &[x, y, z] = positions[i];
      auto &velocity = velocities[i];
      velocity[1] -= static_cast<float>(9.81 * seconds);
      y += velocity[1] * seconds;
      if (y < 0) y = -y, velocity[1] = std::abs(velocity[1]) * 0.3f;
    }
  }
};

int main(int count, char **arguments) try {
  const std::string folder = count > 1 ? arguments[1] : ".";
  Solver solver;
  meniscus::Simulation simulation(meniscus::Options().set("spacing", 0.05).set("smooth", 1.2));
  for (int frame = 0; frame < 5; frame++) {
    solver.step(0.04);
    auto water = meniscus::Particles(solver.positions).attribute("velocity", solver.velocities[0].data(), 3);
    const meniscus::Mesh mesh = simulation.frame(water);
    for (const auto &warning : mesh.warnings()) std::cerr << "frame " << frame << ": " << warning << '\n';
    mesh.overwrite(folder + "/frame_" + std::to_string(frame) + ".vtp");
    std::cout << "frame " << frame << ": " << mesh.triangle_count() << " triangles"
              << (simulation.is_settled() ? ", grid and calibration are fixed\n" : "\n");
  }
} catch (const meniscus::Error &error) {
  std::cerr << error.what() << '\n';
  return error.status;
}
