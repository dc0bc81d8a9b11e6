// A C++17 wrapper of meniscus.h with RAII handles, exceptions and containers. meniscus.h has the
// detailed documentation.
//
// A status other than MENISCUS_STATUS_OK is thrown as meniscus::Error. If a callback throws an
// exception, the call stops its work and throws the same exception.
#ifndef MENISCUS_HPP
#define MENISCUS_HPP

#include "meniscus.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <functional>
#include <initializer_list>
#include <memory>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace meniscus {

// The error of a failed call. The text that what() returns says what is wrong, and where.
class Error : public std::runtime_error {
 public:
  Error(MeniscusStatus status, const std::string &what) : std::runtime_error(what), status(status) {}
  const MeniscusStatus status;
};

inline void check(MeniscusStatus status) {
  if (status != MENISCUS_STATUS_OK) throw Error(status, meniscus_last_error());
}

// A view of contiguous numbers that another object owns.
template <class T>
class Span {
 public:
  Span(const T *data, std::size_t size) : data_(data), size_(size) {}
  const T *data() const { return data_; }
  std::size_t size() const { return size_; }
  bool empty() const { return size_ == 0; }
  const T *begin() const { return data_; }
  const T *end() const { return data_ + size_; }
  const T &operator[](std::size_t index) const { return data_[index]; }

 private:
  const T *data_;
  std::size_t size_;
};

template <class T>
constexpr int32_t number_type() {
  static_assert(std::is_same_v<T, float> || std::is_same_v<T, double> || std::is_same_v<T, int32_t> || std::is_same_v<T, uint32_t>,
                "coordinates are float or double, and attributes also int32_t or uint32_t");
  if constexpr (std::is_same_v<T, int32_t>) return MENISCUS_TYPE_I32;
  if constexpr (std::is_same_v<T, uint32_t>) return MENISCUS_TYPE_U32;
  return std::is_same_v<T, float> ? MENISCUS_TYPE_F32 : MENISCUS_TYPE_F64;
}

// Particles in the caller's memory, which must not change while this object is used. Strides are in
// bytes.
class Particles {
 public:
  template <class T>
  Particles(const T *positions, std::size_t count, std::ptrdiff_t stride = 0, std::ptrdiff_t component_stride = 0) {
    static_assert(std::is_floating_point_v<T>, "coordinates are float or double");
    c_.size = sizeof c_, c_.count = count, c_.positions = positions, c_.number = number_type<T>();
    c_.stride = stride, c_.component_stride = component_stride;
  }
  template <class T>
  explicit Particles(const std::vector<std::array<T, 3>> &positions)
      : Particles(reinterpret_cast<const T *>(positions.data()), positions.size()) {}

  // Adds an attribute of the particles; its name must live as long as this object.
  template <class T>
  Particles &attribute(const char *name, const T *values, uint32_t components, std::ptrdiff_t stride = 0) {
    MeniscusAttribute attribute{};
    attribute.size = sizeof attribute, attribute.name = name, attribute.values = values, attribute.stride = stride;
    attribute.components = components, attribute.number = number_type<T>();
    attributes_.push_back(attribute);
    return *this;
  }

  // The C structure, valid until this object changes or is destroyed.
  MeniscusParticles c() const {
    MeniscusParticles c = c_;
    c.attributes = attributes_.data(), c.attribute_count = attributes_.size();
    return c;
  }

 private:
  MeniscusParticles c_{};
  std::vector<MeniscusAttribute> attributes_;
};

namespace detail {

template <auto free>
struct Free {
  template <class T>
  void operator()(T *handle) const {
    free(handle);
  }
};

template <class T, auto free>
using Handle = std::unique_ptr<T, Free<free>>;

}  // namespace detail

// A handle with which any thread can cancel work: Options::cancel_by takes it.
class Cancel {
 public:
  void cancel() { meniscus_cancel(handle_.get()); }
  const MeniscusCancel *c() const { return handle_.get(); }

 private:
  detail::Handle<MeniscusCancel, meniscus_cancel_free> handle_{meniscus_cancel_new()};
};

// Options, set by their keys: `Options().set("spacing", 0.05).set("normals", true)`.
class Options {
 public:
  Options() = default;
  Options(const Options &other) : on_progress_(other.on_progress_), handle_(meniscus_options_copy(other.c())) {}
  Options(Options &&) = default;
  Options &operator=(Options other) {
    on_progress_ = std::move(other.on_progress_), handle_ = std::move(other.handle_);
    return *this;
  }

  // Sets an option from a number, a bool or a string. Throws if the key is unknown, or if the value
  // has the wrong type.
  template <class T>
  Options &set(const std::string &key, const T &value) {
    if constexpr (std::is_same_v<T, bool>) {
      check(meniscus_options_set(handle_.get(), key.c_str(), value ? "true" : "false"));
    } else if constexpr (std::is_arithmetic_v<T>) {
      check(meniscus_options_set_number(handle_.get(), key.c_str(), static_cast<double>(value)));
    } else {
      check(meniscus_options_set(handle_.get(), key.c_str(), std::string(value).c_str()));
    }
    return *this;
  }
  // Sets an option from several numbers: `set("origin", {0, 0, 0.5})`.
  Options &set(const std::string &key, std::initializer_list<double> values) {
    return set_numbers(key, values.begin(), values.size());
  }
  Options &set(const std::string &key, const std::vector<double> &values) {
    return set_numbers(key, values.data(), values.size());
  }
  // Resets an option to its default.
  Options &clear(const std::string &key) {
    check(meniscus_options_set(handle_.get(), key.c_str(), nullptr));
    return *this;
  }
  // Sets the function that receives progress; it returns false to cancel the work.
  Options &on_progress(std::function<bool(const MeniscusProgress &)> progress) {
    on_progress_ = std::move(progress);
    return *this;
  }
  const std::function<bool(const MeniscusProgress &)> &on_progress() const { return on_progress_; }
  // Sets the handle with which any thread can cancel the work.
  Options &cancel_by(const Cancel &cancel) {
    check(meniscus_options_cancel_by(handle_.get(), cancel.c()));
    return *this;
  }

  const MeniscusOptions *c() const { return handle_.get(); }

 private:
  using Handle = detail::Handle<MeniscusOptions, meniscus_options_free>;

  Options &set_numbers(const std::string &key, const double *values, std::size_t count) {
    check(meniscus_options_set_numbers(handle_.get(), key.c_str(), values, count));
    return *this;
  }

  std::function<bool(const MeniscusProgress &)> on_progress_;
  Handle handle_{meniscus_options_new()};
};

namespace detail {

// A copy of the options for one call. Its progress callback catches exceptions, which must not pass
// through the C library; `check` throws them again.
class CallOptions {
 public:
  explicit CallOptions(const Options &options)
      : on_progress_(options.on_progress()), handle_(meniscus_options_copy(options.c())) {
    if (!on_progress_) return;
    meniscus::check(meniscus_options_on_progress(handle_.get(), &CallOptions::report_progress, this));
  }
  CallOptions(const CallOptions &) = delete;
  CallOptions &operator=(const CallOptions &) = delete;
  const MeniscusOptions *c() const { return handle_.get(); }

  // Throws the exception of the callback, if there was one, or else the error of the call.
  void check(MeniscusStatus status) {
    if (auto thrown = std::exchange(thrown_, nullptr)) std::rethrow_exception(thrown);
    meniscus::check(status);
  }

 private:
  static int32_t report_progress(void *user, const MeniscusProgress *progress) noexcept {
    auto *self = static_cast<CallOptions *>(user);
    try {
      return self->on_progress_(*progress) ? 0 : 1;
    } catch (...) {
      self->thrown_ = std::current_exception();
      return 1;
    }
  }

  const std::function<bool(const MeniscusProgress &)> on_progress_;
  Handle<MeniscusOptions, meniscus_options_free> handle_;
  std::exception_ptr thrown_;
};

}  // namespace detail

// A surface: a closed, oriented 2-manifold.
class Mesh {
 public:
  explicit Mesh(MeniscusMesh *handle) : handle_(handle) {}

  uint64_t vertex_count() const { return meniscus_mesh_vertex_count(c()); }
  uint64_t triangle_count() const { return meniscus_mesh_triangle_count(c()); }

  // The coordinates x, y, z of each vertex. Every Span of a mesh is valid as long as the mesh
  // lives.
  Span<double> positions() const { return {arrays().positions, 3 * arrays().vertex_count}; }
  // The three vertices of each triangle, counterclockwise seen from outside.
  Span<uint32_t> triangles() const { return {arrays().triangles, 3 * arrays().triangle_count}; }
  // The normal of each vertex; empty if no normals were requested.
  Span<float> normals() const { return {arrays().normals, arrays().normals ? 3 * arrays().vertex_count : 0}; }
  // All components of the attribute with this name, vertex by vertex; integers are rounded to
  // float.
  Span<float> attribute(const std::string &name) const {
    const MeniscusArrays all = arrays();
    for (const auto &one : Span(all.attributes, all.attribute_count)) {
      if (name == one.name) return {one.values, one.components * all.vertex_count};
    }
    throw std::out_of_range("the mesh has no attribute " + name);
  }

  // A copy of the positions, as float or double.
  template <class T>
  std::vector<T> copy_positions() const {
    static_assert(std::is_floating_point_v<T>, "coordinates are float or double");
    std::vector<T> out(3 * vertex_count());
    if constexpr (number_type<T>() == MENISCUS_TYPE_F32) {
      check(meniscus_mesh_positions_f32(c(), out.data(), out.size()));
    } else {
      check(meniscus_mesh_positions_f64(c(), out.data(), out.size()));
    }
    return out;
  }
  // The exact values of the integer attribute with this name, vertex by vertex.
  std::vector<int64_t> copy_whole(const std::string &name) const {
    for (std::size_t i = 0; i < meniscus_mesh_attribute_count(c()); i++) {
      if (name != meniscus_mesh_attribute_name(c(), i)) continue;
      std::vector<int64_t> out(meniscus_mesh_attribute_components(c(), i) * vertex_count());
      check(meniscus_mesh_attribute_whole(c(), i, out.data(), out.size()));
      return out;
    }
    throw std::out_of_range("the mesh has no attribute " + name);
  }
  std::vector<uint64_t> copy_triangles() const {
    std::vector<uint64_t> out(3 * triangle_count());
    check(meniscus_mesh_triangles_u64(c(), out.data(), out.size()));
    return out;
  }

  // The warnings about the surface and about its request.
  std::vector<std::string> warnings() const {
    std::vector<std::string> all;
    for (std::size_t i = 0; i < meniscus_mesh_warning_count(c()); i++) all.emplace_back(meniscus_mesh_warning(c(), i));
    return all;
  }
  MeniscusReport report() const { return filled<MeniscusReport>(meniscus_mesh_report); }
  MeniscusCheck checked() const { return filled<MeniscusCheck>(meniscus_mesh_check); }

  // Writes a new mesh file, and returns its size in bytes. Throws if the file exists.
  uint64_t write(const std::string &path) const { return write(path, 0); }
  // Writes a mesh file, and replaces an existing file.
  uint64_t overwrite(const std::string &path) const { return write(path, 1); }

  const MeniscusMesh *c() const { return handle_.get(); }

 private:
  uint64_t write(const std::string &path, int32_t overwrite) const {
    uint64_t bytes = 0;
    check(meniscus_mesh_write(c(), path.c_str(), overwrite, &bytes));
    return bytes;
  }
  template <class T, class Fill>
  T filled(Fill fill) const {
    T value{};
    value.size = sizeof value;
    check(fill(c(), &value));
    return value;
  }
  MeniscusArrays arrays() const { return filled<MeniscusArrays>(meniscus_mesh_arrays); }

  detail::Handle<MeniscusMesh, meniscus_mesh_free> handle_;
};

// Reconstructs the surface of particles.
inline Mesh reconstruct(const Particles &particles, const Options &options = {}) {
  detail::CallOptions call_options(options);
  const MeniscusParticles c = particles.c();
  MeniscusMesh *mesh = nullptr;
  call_options.check(meniscus_reconstruct(&c, call_options.c(), &mesh));
  return Mesh(mesh);
}

// Reconstructs the surface of the particles in a file, or of a packed frame.
inline Mesh reconstruct(const std::string &path, const Options &options = {}) {
  detail::CallOptions call_options(options);
  MeniscusMesh *mesh = nullptr;
  call_options.check(meniscus_reconstruct_file(path.c_str(), call_options.c(), &mesh));
  return Mesh(mesh);
}

// A frame that is sampled once, so that several surfaces can be computed from it.
class Frame {
 public:
  explicit Frame(const Particles &particles, const Options &options = {}) {
    detail::CallOptions call_options(options);
    const MeniscusParticles c = particles.c();
    sample_into_handle(call_options, [&](MeniscusFrame **frame) { return meniscus_sample(&c, call_options.c(), frame); });
  }
  explicit Frame(const std::string &path, const Options &options = {}) {
    detail::CallOptions call_options(options);
    sample_into_handle(call_options, [&](MeniscusFrame **frame) { return meniscus_sample_file(path.c_str(), call_options.c(), frame); });
  }

  // Computes the surface with the options of the constructor.
  Mesh surface() const {
    MeniscusMesh *mesh = nullptr;
    check(meniscus_frame_surface(handle_.get(), nullptr, &mesh));
    return Mesh(mesh);
  }
  // Computes a surface with other options.
  Mesh surface(const Options &options) const {
    detail::CallOptions call_options(options);
    MeniscusMesh *mesh = nullptr;
    call_options.check(meniscus_frame_surface(handle_.get(), call_options.c(), &mesh));
    return Mesh(mesh);
  }
  // Packs the frame into a new .mnf file, and returns its size in bytes. Throws if the file exists.
  uint64_t pack(const std::string &path) const {
    uint64_t bytes = 0;
    check(meniscus_frame_pack(handle_.get(), path.c_str(), 0, &bytes));
    return bytes;
  }

 private:
  template <class Sample>
  void sample_into_handle(detail::CallOptions &call_options, Sample sample) {
    MeniscusFrame *frame = nullptr;
    call_options.check(sample(&frame));
    handle_.reset(frame);
  }
  detail::Handle<MeniscusFrame, meniscus_frame_free> handle_;
};

// A running simulation: its frames come from memory, in order, and share one calibration.
class Simulation {
 public:
  explicit Simulation(const Options &options = {}) : call_options_(std::make_unique<detail::CallOptions>(options)) {
    MeniscusSimulation *simulation = nullptr;
    call_options_->check(meniscus_simulation_new(call_options_->c(), &simulation));
    handle_.reset(simulation);
  }
  // Reconstructs the surface of the next frame.
  Mesh frame(const Particles &particles) {
    const MeniscusParticles c = particles.c();
    MeniscusMesh *mesh = nullptr;
    call_options_->check(meniscus_simulation_frame(handle_.get(), &c, &mesh));
    return Mesh(mesh);
  }
  // Whether cells, grid and calibration are fixed.
  bool is_settled() const { return meniscus_simulation_is_settled(handle_.get()) != 0; }

 private:
  std::unique_ptr<detail::CallOptions> call_options_;
  detail::Handle<MeniscusSimulation, meniscus_simulation_free> handle_;
};

}  // namespace meniscus

#endif
