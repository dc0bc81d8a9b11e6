// Computes the surface of a particle file with OpenVDB: with points::rasterizeSmoothSpheres (the
// method of Zhu and Bridson), or with points::pca and points::rasterizeSdf on ellipsoids (the
// method of Yu and Turk, since OpenVDB 12.1).
//
// usage: openvdb METHOD IN.xyz|IN.csv OUT.ply SPACING VOXEL ISOVALUE THREADS
//        openvdb --version
//
// IN.xyz: raw f32 triples. IN.csv, for the method spheres: rows of x, y, z and the sphere's radius,
// below a line of names. VOXEL and ISOVALUE are in units of SPACING; the isovalue is a distance
// outwards. METHOD:
//
// - spheres: the spheres' radius is half a spacing, and the search radius is two spacings, or four
//   times the largest radius.
// - ellipsoids: OpenVDB's defaults, with half a spacing as the radius. The search radius is 2.5
//   spacings, so that particles at the surface also have the 20 neighbours that the default
//   threshold requires.
// - tuned: like ellipsoids, but with a radius of 1.2 spacings, with 0.5 for averagePositions and
//   nonAnisotropicStretch, and with 3 as the required number of neighbours of an ellipsoid, so that
//   the surface of a level pool is level and sheets do not tear.
#include <openvdb/openvdb.h>
#include <openvdb/points/PointConversion.h>
#include <openvdb/points/PointRasterizeSDF.h>
#if __has_include(<openvdb/points/PrincipalComponentAnalysis.h>)
#define HAS_ELLIPSOIDS
#include <openvdb/points/PrincipalComponentAnalysis.h>
#endif
#include <openvdb/tools/VolumeToMesh.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <cstddef>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

// The number of voxels on either side of the surface that store distances.
const double half_width = openvdb::LEVEL_SET_HALF_WIDTH;

struct Particles {
    std::vector<openvdb::Vec3s> points;
    // Empty if all particles have one radius.
    std::vector<float> radii;
};

Particles read(const std::string& path) {
    std::ifstream in(path, std::ios::binary);
    Particles particles;
    const std::string table = ".csv";
    if (path.size() > table.size() && path.compare(path.size() - table.size(), table.size(), table) == 0) {
        std::string line;
        std::getline(in, line);
        float x, y, z, radius;
        while (std::getline(in, line) && std::sscanf(line.c_str(), "%f,%f,%f,%f", &x, &y, &z, &radius) == 4) {
            particles.points.emplace_back(x, y, z);
            particles.radii.push_back(radius);
        }
        return particles;
    }
    const std::vector<char> bytes((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
    auto& points = particles.points;
    points.resize(bytes.size() / sizeof(openvdb::Vec3s));
    std::memcpy(static_cast<void*>(points.data()), bytes.data(), points.size() * sizeof(openvdb::Vec3s));
    return particles;
}

openvdb::points::PointDataGrid::Ptr bin(const Particles& particles, const double spacing) {
    // Bins of one spacing suit the rasterizers for any voxel size.
    const auto bins = openvdb::math::Transform::createLinearTransform(spacing);
    const openvdb::points::PointAttributeVector<openvdb::Vec3s> positions(particles.points);
    const auto index =
        openvdb::tools::createPointIndexGrid<openvdb::tools::PointIndexGrid>(positions, *bins);
    const auto grid = openvdb::points::createPointDataGrid<openvdb::points::NullCodec, openvdb::points::PointDataGrid>(
        *index, positions, *bins);
    if (!particles.radii.empty()) {
        const openvdb::points::PointAttributeVector<float> radii(particles.radii);
        openvdb::points::appendAttribute<float>(grid->tree(), "radius");
        openvdb::points::populateAttribute(grid->tree(), index->tree(), "radius", radii);
    }
    return grid;
}

#ifdef HAS_ELLIPSOIDS
openvdb::FloatGrid::Ptr ellipsoids(openvdb::points::PointDataGrid& points, const openvdb::points::PcaSettings& settings,
                                   const double radius, const openvdb::math::Transform::Ptr& transform) {
    const openvdb::points::PcaAttributes attributes;
    openvdb::points::pca(points, settings, attributes);
    openvdb::points::EllipsoidSettings<> shapes;
    shapes.radius = attributes.stretch;
    shapes.xform = attributes.xform;
    shapes.pws = attributes.positionWS;
    shapes.radiusScale = openvdb::Vec3d(radius);
    shapes.halfband = half_width;
    shapes.transform = transform;
    return openvdb::gridPtrCast<openvdb::FloatGrid>(openvdb::points::rasterizeSdf(points, shapes)[0]);
}
#endif

openvdb::FloatGrid::Ptr rasterize(const std::string& method, const Particles& particles, const double spacing,
                                  const double voxel) {
    const auto transform = openvdb::math::Transform::createLinearTransform(voxel);
    const auto grid = bin(particles, spacing);
    if (!particles.radii.empty()) {
        if (method != "spheres") throw std::invalid_argument("this method has one radius for all particles");
        const double largest = *std::max_element(particles.radii.begin(), particles.radii.end());
        return openvdb::points::rasterizeSmoothSpheres(*grid, "radius", 1.0, 4.0 * largest, half_width, transform);
    }
    if (method == "spheres") {
        return openvdb::points::rasterizeSmoothSpheres(*grid, 0.5 * spacing, 2.0 * spacing, half_width, transform);
    }
#ifdef HAS_ELLIPSOIDS
    openvdb::points::PcaSettings settings;
    settings.searchRadius = static_cast<float>(2.5 * spacing);
    if (method == "ellipsoids") return ellipsoids(*grid, settings, 0.5 * spacing, transform);
    if (method == "tuned") {
        settings.neighbourThreshold = 3;
        settings.averagePositions = 0.5f;
        settings.nonAnisotropicStretch = 0.5f;
        return ellipsoids(*grid, settings, 1.2 * spacing, transform);
    }
#endif
    throw std::invalid_argument("this version of OpenVDB does not have the method " + method);
}

// Writes a .ply. Divides each quad into two triangles, and reverses all polygons, because OpenVDB's
// polygons face inwards.
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
    if (count == 2 && std::string(arguments[1]) == "--version") {
#ifdef HAS_ELLIPSOIDS
        std::printf("OpenVDB %s with ellipsoids\n", openvdb::getLibraryVersionString());
#else
        std::printf("OpenVDB %s\n", openvdb::getLibraryVersionString());
#endif
        return 0;
    }
    if (count != 8) {
        std::fprintf(stderr, "usage: openvdb METHOD IN.xyz|IN.csv OUT.ply SPACING VOXEL ISOVALUE THREADS\n");
        return 2;
    }
    const double spacing = std::stod(arguments[4]);
    const auto threads = static_cast<std::size_t>(std::stoul(arguments[7]));
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    openvdb::initialize();
    const auto surface = rasterize(arguments[1], read(arguments[2]), spacing, spacing * std::stod(arguments[5]));
    write(arguments[3], *surface, spacing * std::stod(arguments[6]));
    return 0;
}
