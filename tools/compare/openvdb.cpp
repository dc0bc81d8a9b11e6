// Surfaces of particles by OpenVDB's points::rasterizeSmoothSpheres (Zhu and Bridson's), file to file.
//
// usage: openvdb IN.xyz OUT.ply SPACING VOXEL ISOVALUE THREADS
//
// IN.xyz: raw f32 triples. VOXEL and ISOVALUE, a distance outwards, are in units of SPACING.
// Spheres have half a spacing as their radius, and the search radius is two.
#include <openvdb/openvdb.h>
#include <openvdb/points/PointConversion.h>
#include <openvdb/points/PointRasterizeSDF.h>
#include <openvdb/tools/VolumeToMesh.h>
#include <tbb/global_control.h>

#include <cstddef>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

namespace {

// Voxels on either side of the surface that hold distances.
const double half_width = openvdb::LEVEL_SET_HALF_WIDTH;

std::vector<openvdb::Vec3s> read(const char* path) {
    std::ifstream in(path, std::ios::binary);
    const std::vector<char> bytes((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
    std::vector<openvdb::Vec3s> points(bytes.size() / sizeof(openvdb::Vec3s));
    std::memcpy(static_cast<void*>(points.data()), bytes.data(), points.size() * sizeof(openvdb::Vec3s));
    return points;
}

openvdb::FloatGrid::Ptr rasterize(const std::vector<openvdb::Vec3s>& points, const double spacing, const double voxel) {
    const auto transform = openvdb::math::Transform::createLinearTransform(voxel);
    // Bins of about a spacing suit the rasterizer, independent of the voxels.
    const auto bins = openvdb::math::Transform::createLinearTransform(spacing);
    const openvdb::points::PointAttributeVector<openvdb::Vec3s> positions(points);
    const auto index =
        openvdb::tools::createPointIndexGrid<openvdb::tools::PointIndexGrid>(positions, *bins);
    const auto grid = openvdb::points::createPointDataGrid<openvdb::points::NullCodec, openvdb::points::PointDataGrid>(
        *index, positions, *bins);
    return openvdb::points::rasterizeSmoothSpheres(*grid, 0.5 * spacing, 2.0 * spacing, half_width, transform);
}

// Quads are cut in two. OpenVDB's polygons face inwards.
void write(const char* path, const openvdb::FloatGrid& surface, const double isovalue) {
    std::vector<openvdb::Vec3s> points;
    std::vector<openvdb::Vec3I> triangles;
    std::vector<openvdb::Vec4I> quads;
    openvdb::tools::volumeToMesh(surface, points, triangles, quads, isovalue);
    std::vector<openvdb::Vec3I> faces;
    for (const auto& t : triangles) faces.emplace_back(t[0], t[2], t[1]);
    for (const auto& q : quads) {
        faces.emplace_back(q[0], q[2], q[1]);
        faces.emplace_back(q[0], q[3], q[2]);
    }
    std::ofstream out(path, std::ios::binary);
    out << "ply\nformat binary_little_endian 1.0\nelement vertex " << points.size()
        << "\nproperty float x\nproperty float y\nproperty float z\nelement face " << faces.size()
        << "\nproperty list uchar int vertex_indices\nend_header\n";
    out.write(reinterpret_cast<const char*>(points.data()),
              static_cast<std::streamsize>(points.size() * sizeof(openvdb::Vec3s)));
    for (const auto& face : faces) {
        out.put(3);
        out.write(reinterpret_cast<const char*>(&face), sizeof face);
    }
}

}  // namespace

int main(int count, char** arguments) {
    if (count != 7) {
        std::fprintf(stderr, "usage: openvdb IN.xyz OUT.ply SPACING VOXEL ISOVALUE THREADS\n");
        return 2;
    }
    const double spacing = std::stod(arguments[3]);
    const auto threads = static_cast<std::size_t>(std::stoul(arguments[6]));
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    openvdb::initialize();
    const auto surface = rasterize(read(arguments[1]), spacing, spacing * std::stod(arguments[4]));
    write(arguments[2], *surface, spacing * std::stod(arguments[5]));
    return 0;
}
