/* meniscus: watertight surface meshes from particle fluids (SPH, PBD, FLIP, MPM).

   Made by cbindgen of the library's sources: `cargo run -p meniscus-c-header` renews it.

   Calls. Every function that can fail returns a MeniscusStatus; meniscus_last_error() says what is wrong, and where. NULL, wrong sizes,
   numbers that are none or out of range, and what is wrong with particles or files are such failures, and never a crash.

   Options. The options of a call are the program's, set by their keys:
   `meniscus_options_set(options, "spacing", "0.05")`.

   Structures. Those whose first field is `size` may grow: fill them with zeros, set their size and
   what you want to say, as by `MeniscusReport report = {.size = sizeof report};`. The library takes
   structures of older headers, and those of newer ones if the fields it does not know are 0.

   Memory. Handles (MeniscusOptions, MeniscusMesh, MeniscusFrame, MeniscusSimulation,
   MeniscusCancel) are the library's, and each is freed by the function that says so. Copies go to
   memory of the caller's, who says how many numbers that holds. What is lent lives as long as its
   handle.

   Threads. Functions may be called from any number of threads at once. A handle may be used by several threads at once, unless it is
   said otherwise, as long as none frees it. Every call computes on threads of its own.

   Units. Lengths are in the unit of the particles' positions, whatever that is; "in cells" and "in spacings" are said where it is so. */

#ifndef MENISCUS_H
#define MENISCUS_H

#include <stddef.h>
#include <stdint.h>

// Outcome of a call: whose fault it is if it failed. The numbers are those that the program
// `meniscus` exits with.
enum MeniscusStatus
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // Done.
  MENISCUS_STATUS_OK = 0,
  // Some frames of a conversion failed or are missing; the others are done.
  MENISCUS_STATUS_INCOMPLETE = 1,
  // An argument or an option is wrong, or options exclude each other; nothing was done.
  MENISCUS_STATUS_REQUEST = 2,
  // The particles, or a file that was to be read, are bad.
  MENISCUS_STATUS_INPUT = 3,
  // A file cannot be written, or scratch files fail.
  MENISCUS_STATUS_OUTPUT = 4,
  // The Vulkan device that was asked for cannot be used.
  MENISCUS_STATUS_DEVICE = 5,
  // A bug of the library: please report it. The handles that the call was given are fit for
  // nothing but to be freed.
  MENISCUS_STATUS_INTERNAL = 70,
  // A callback or another thread asked for an early end.
  MENISCUS_STATUS_CANCELLED = 130,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum MeniscusStatus MeniscusStatus;
#else
typedef int32_t MeniscusStatus;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// A step on the way from particles to a mesh file.
enum MeniscusStage
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // A stage that is newer than this header.
  MENISCUS_STAGE_OTHER = 0,
  // The input is read.
  MENISCUS_STAGE_READING = 1,
  // Particles are counted in the cells, to know what memory the frame takes.
  MENISCUS_STAGE_COUNTING = 2,
  // A large frame waits until others are done.
  MENISCUS_STAGE_WAITING = 3,
  // Particles are sampled on the grid.
  MENISCUS_STAGE_SAMPLING = 4,
  // The field is meshed.
  MENISCUS_STAGE_MESHING = 5,
  // The mesh is simplified.
  MENISCUS_STAGE_SIMPLIFYING = 6,
  // The mesh is written.
  MENISCUS_STAGE_WRITING = 7,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum MeniscusStage MeniscusStage;
#else
typedef int32_t MeniscusStage;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// The type of numbers in the caller's memory. Positions are F32 or F64.
enum MeniscusType
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // float, 4 bytes.
  MENISCUS_TYPE_F32 = 0,
  // double, 8 bytes.
  MENISCUS_TYPE_F64 = 1,
  // int32_t, 4 bytes: for attributes.
  MENISCUS_TYPE_I32 = 2,
  // uint32_t, 4 bytes: for attributes.
  MENISCUS_TYPE_U32 = 3,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum MeniscusType MeniscusType;
#else
typedef int32_t MeniscusType;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// Where a spacing comes from.
enum MeniscusSpacingSource
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // Not known: the frame was packed, or is one of a simulation.
  MENISCUS_SPACING_SOURCE_UNKNOWN = 0,
  // The options.
  MENISCUS_SPACING_SOURCE_GIVEN = 1,
  // The particles' file.
  MENISCUS_SPACING_SOURCE_FILE = 2,
  // A scene beside it.
  MENISCUS_SPACING_SOURCE_SCENE = 3,
  // The particles themselves.
  MENISCUS_SPACING_SOURCE_ESTIMATED = 4,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum MeniscusSpacingSource MeniscusSpacingSource;
#else
typedef int32_t MeniscusSpacingSource;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// News of a conversion.
enum MeniscusEventKind
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // Something that is newer than this header.
  MENISCUS_EVENT_KIND_OTHER = 0,
  // No frame has come yet, and one is waited for.
  MENISCUS_EVENT_KIND_WAITING = 1,
  // The spacing that a frame says, or looks like, may not be right.
  MENISCUS_EVENT_KIND_SPACING_WARNING = 2,
  // The state of an earlier run is made anew, because settings or its input changed.
  MENISCUS_EVENT_KIND_RESTARTED = 3,
  // The frames of an earlier run are gone on with.
  MENISCUS_EVENT_KIND_RESUMED = 4,
  // The measurements that all frames share are made.
  MENISCUS_EVENT_KIND_MEASURED = 5,
  // The frames that are to be made are known.
  MENISCUS_EVENT_KIND_STARTED = 6,
  // A further frame has come.
  MENISCUS_EVENT_KIND_FRAME_APPEARED = 7,
  // A frame is at a stage, or is over.
  MENISCUS_EVENT_KIND_STAGE = 8,
  // A frame is done: its mesh is whole, and under its name.
  MENISCUS_EVENT_KIND_DONE = 9,
  // A frame could not be made.
  MENISCUS_EVENT_KIND_FAILED = 10,
  // One of several simulations could not be converted; the others are.
  MENISCUS_EVENT_KIND_SIMULATION_FAILED = 11,
  // All frames of a simulation are done, or have failed.
  MENISCUS_EVENT_KIND_ENDED = 12,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum MeniscusEventKind MeniscusEventKind;
#else
typedef int32_t MeniscusEventKind;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// A handle to end work early from any thread. Work that was begun with it, or is begun later, ends
// with MENISCUS_STATUS_CANCELLED: a handle is not used again once it was cancelled. It may be
// freed while such work runs.
typedef struct MeniscusCancel MeniscusCancel;

// A frame that was sampled: particles as a field, from which surfaces are drawn by other filters
// without the particles. Freed by meniscus_frame_free.
//
// Several threads may use it at once, as long as none frees it.
typedef struct MeniscusFrame MeniscusFrame;

// A surface: a closed, oriented 2-manifold around the fluid. Freed by meniscus_mesh_free.
//
// Several threads may use it at once, as long as none frees it.
typedef struct MeniscusMesh MeniscusMesh;

// Options of a call, by the keys of the program's options: "spacing", "cell-size", "threads".
// Freed by meniscus_options_free.
//
// `meniscus reconstruct --help` documents the options, and meniscus_options_key lists their keys.
// An option that is not set has the program's default, except that stages run on the CPU unless
// "backend" or "device" is set. NULL instead of options sets none.
//
// A call copies the options when it begins, so that they may be changed or freed as soon as it
// returns. Several threads may use the same options at once, as long as none changes or frees
// them.
typedef struct MeniscusOptions MeniscusOptions;

// A simulation whose frames come from memory, one after the other. Freed by
// meniscus_simulation_free.
//
// Cells, grid and calibration are measured on the first frame with fluid deeper than the filters
// reach, and frozen: the frames from then on are alike. It makes one frame at a time.
typedef struct MeniscusSimulation MeniscusSimulation;

// The end of a conversion. The caller sets `size`, and the library fills the rest.
typedef struct MeniscusSummary {
  // sizeof(MeniscusSummary).
  size_t size;
  // Frames that were made.
  uint64_t made;
  // Frames that have failed.
  uint64_t failed;
  // Frames that are missing between others.
  uint64_t missing;
  // Particles in the frames that were made.
  uint64_t particles;
  // Particles that are in no surface, at the least.
  uint64_t lost;
  // How long it took in seconds.
  double seconds;
} MeniscusSummary;

// A value that every particle carries: one number, or several. To be filled with zeros but for
// what is said.
typedef struct MeniscusAttribute {
  // sizeof(MeniscusAttribute).
  size_t size;
  // The name, by which it is asked for and the vertices have it. "velocity" of three components,
  // or another usual name of it such as "v" or "vel", is carried to the vertices where nothing
  // else is asked for.
  const char *name;
  // The first number of the first particle; need not be aligned.
  const void *values;
  // Bytes from a particle's first number to the next particle's; 0 where values lie side by
  // side. May be negative.
  ptrdiff_t stride;
  // Bytes from one number of a particle to its next; 0 where they lie side by side. May be
  // negative.
  ptrdiff_t component_stride;
  // Numbers per particle, from 1 to 65536.
  uint32_t components;
  // The type of the numbers, one of MeniscusType. F32 and F64 are carried as float: a double that
  // is not finite as such counts as none. I32 and U32, such as identifiers, are carried as they
  // are: a vertex has those of the particle nearest to it, for meniscus_mesh_attribute_whole.
  int32_t number;
} MeniscusAttribute;

// Particles in memory. To be filled with zeros but for what is said.
//
// They are read where they are, several times and by several threads, while the call lasts that is
// given them, and must stay as they are meanwhile. Positions are in any unit, the same for all
// lengths.
typedef struct MeniscusParticles {
  // sizeof(MeniscusParticles).
  size_t size;
  // The number of particles.
  uint64_t count;
  // The first particle's x; need not be aligned.
  const void *positions;
  // Bytes from a particle's x to the next particle's; 0 where positions lie side by side. May be
  // negative.
  ptrdiff_t stride;
  // Bytes from x to y, and from y to z; 0 where they lie side by side. May be negative.
  ptrdiff_t component_stride;
  // Further values of the particles, side by side; NULL for none.
  const struct MeniscusAttribute *attributes;
  // How many attributes there are.
  size_t attribute_count;
  // The type of the coordinates, MENISCUS_TYPE_F32 or MENISCUS_TYPE_F64.
  int32_t number;
  // Must be 0.
  int32_t reserved;
} MeniscusParticles;

// A value on the vertices of a mesh, lent by the mesh.
typedef struct MeniscusMeshAttribute {
  // The name.
  const char *name;
  // All components of one vertex after the other. Whole numbers are rounded to float:
  // meniscus_mesh_attribute_whole copies them as they are.
  const float *values;
  // Numbers per vertex.
  uint64_t components;
} MeniscusMeshAttribute;

// A mesh in memory of the library's. The caller sets `size`, and the library fills the rest; all
// pointers are valid until the mesh is freed, and NULL where there is nothing.
typedef struct MeniscusArrays {
  // sizeof(MeniscusArrays).
  size_t size;
  // How many vertices there are.
  uint64_t vertex_count;
  // How many triangles there are.
  uint64_t triangle_count;
  // 3 numbers a vertex: x, y, z, in the unit of the particles' positions.
  const double *positions;
  // 3 numbers a triangle: its vertices, counterclockwise seen from outside.
  const uint32_t *triangles;
  // 3 numbers a vertex: the normal, of length 1, outward; NULL where none were asked for.
  const float *normals;
  // The other values of the vertices.
  const struct MeniscusMeshAttribute *attributes;
  // How many attributes there are.
  size_t attribute_count;
} MeniscusArrays;

// How a mesh was made. The caller sets `size`, and the library fills the rest. Lengths are in the
// unit of the positions.
typedef struct MeniscusReport {
  // sizeof(MeniscusReport).
  size_t size;
  // Distance between neighbouring particles; 0 where it is not known.
  double spacing;
  // Edge of a cell.
  double cell_size;
  // A corner of the grid's cells.
  double origin[3];
  // Width of smoothing in spacings, for clouds; else 0.
  double smooth;
  // Width of the Gaussian in cells, for the paper's indicators; else 0.
  double sigma;
  // The isovalue, where the surface is drawn by one; else 0.
  double isovalue;
  // Seconds that the stages took, without writing.
  double seconds;
  // Particles that are in the field.
  uint64_t particles;
  // Particles that were left out, for a coordinate is not finite.
  uint64_t not_finite;
  // Particles that were left out, for they are too far away.
  uint64_t too_far;
  // Particles that do not count, for they are outside of the tank.
  uint64_t outside;
  // Particles that are in no surface, at the least.
  uint64_t lost;
  // Components that were left out by smallest_component.
  uint64_t small_components;
  // Drops that were left out by smallest_drop.
  uint64_t small_drops;
  // Triangles before simplifying and leaving out.
  uint64_t whole_triangles;
  // Threads that made it.
  uint32_t threads;
  // One of MeniscusSpacingSource.
  int32_t spacing_source;
} MeniscusReport;

// Findings of `meniscus check` on a mesh. The caller sets `size`, and the library fills the rest.
typedef struct MeniscusCheck {
  // sizeof(MeniscusCheck).
  size_t size;
  // The area of all triangles, in the square of the unit of the positions.
  double area;
  // The volume inside, in the cube of the unit of the positions; NaN unless closed and oriented.
  double volume;
  // The lowest corner of the box around the vertices; 0 of an empty mesh.
  double lowest[3];
  // The highest corner of the box around the vertices; 0 of an empty mesh.
  double highest[3];
  // Pieces that share no vertex.
  uint64_t components;
  // Handles, of all components together; -1 unless closed, oriented and 2-manifold.
  int64_t genus;
  // Edges with one triangle only.
  uint64_t boundary_edges;
  // Edges whose two triangles run along them the same way.
  uint64_t misoriented_edges;
  // Edges with more than two triangles.
  uint64_t crowded_edges;
  // Vertices whose triangles form more than one fan.
  uint64_t pinched_vertices;
  // Triangles that name one vertex twice.
  uint64_t degenerate_triangles;
  // Vertices with a coordinate that is not finite.
  uint64_t non_finite_vertices;
  // 1 if it is closed, oriented and 2-manifold, and all positions are finite; else 0.
  int32_t is_closed_oriented_manifold;
  // Always 0.
  int32_t reserved;
} MeniscusCheck;

// Progress of a frame. The library fills it, and a later version may put more behind.
typedef struct MeniscusProgress {
  // Bytes of this structure as the library knows it.
  size_t size;
  // The stage in one word, such as "meshing"; valid during the callback.
  const char *name;
  // The share of this stage that is done, from 0 to 1.
  double done;
  // The stage, one of MeniscusStage.
  int32_t stage;
} MeniscusProgress;

// A function that is told of progress. It returns 0 for the work to go on, and anything else to
// end it early: the call then returns MENISCUS_STATUS_CANCELLED.
//
// It is called from threads of the library, but never from two at once in the same call, and never
// after the call has returned. It must not throw, nor leave by longjmp.
typedef int32_t (*MeniscusProgressCallback)(void *user, const struct MeniscusProgress *progress);

// An event of a conversion. The library fills it, and a later version may put more behind.
typedef struct MeniscusEvent {
  // Bytes of this structure as the library knows it.
  size_t size;
  // The event as a line for people; valid during the callback.
  const char *text;
  // The doubts about a frame that is done, a line each; NULL where there are none. Valid during
  // the callback.
  const char *warnings;
  // The number of the frame, for stages, and for frames that are done or failed; negative before
  // frame 0.
  int64_t frame;
  // Frames that are done or have failed so far, where that is known.
  uint64_t done;
  // Frames that are to be made, where that is known.
  uint64_t total;
  // Frames that have failed so far, where that is known.
  uint64_t failed;
  // One of MeniscusEventKind.
  int32_t kind;
  // How much of its stage is done for a frame that is at one, from 0 to 1.
  double share;
} MeniscusEvent;

// A function that is told of events. It returns 0 for the conversion to go on, and anything else
// to end it early: frames that are done stay.
//
// It is called on the thread that called meniscus_convert. It must not throw, nor leave by
// longjmp.
typedef int32_t (*MeniscusEventCallback)(void *user, const struct MeniscusEvent *event);

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Returns the version of the library, such as "0.3.0". The text lives for ever.
const char *meniscus_version(void);

// Makes a handle, to be freed by meniscus_cancel_free.
struct MeniscusCancel *meniscus_cancel_new(void);

// Asks all work with this handle to end soon. May be called from any thread, at any time; NULL is
// ignored.
//
// `cancel` is NULL, or a handle that is not freed yet.
void meniscus_cancel(const struct MeniscusCancel *cancel);

// Frees a handle; NULL is ignored.
//
// `cancel` is NULL, or a handle that is not freed yet.
void meniscus_cancel_free(struct MeniscusCancel *cancel);

// Converts the frames of a simulation from files to files, as the program does: all alike, side by
// side, whole or not at all.
//
// `inputs`: one name with {} for the number, a folder, a glob or a file of several steps; or the
// files of `input_count` frames; or, with the option "together", inputs whose frames of one number
// are one. `output`: a name with {} or {:04} for the number, or a folder.
// `options`: which frames, and how; NULL for all defaults. Their progress function is not called.
// `summary`: NULL, or where to put what was done.
//
// MENISCUS_STATUS_INCOMPLETE where frames failed or are missing between others, and the others are
// done: the message says of the first.
//
// Pointers are NULL or point to the described data.
MeniscusStatus meniscus_convert(const char *const *inputs,
                                size_t input_count,
                                const char *output,
                                const struct MeniscusOptions *options,
                                struct MeniscusSummary *summary);

// Reconstructs the surface of particles in memory.
//
// `options` may be NULL for all defaults. `mesh`: where to put the mesh, to be freed by
// meniscus_mesh_free; NULL where it fails.
//
// MENISCUS_STATUS_REQUEST for arguments and options that are wrong, and for memory that does not
// do; MENISCUS_STATUS_INPUT for particles that are not finite or too far away, have no surface, or
// are none; MENISCUS_STATUS_OUTPUT where scratch files fail.
//
// Pointers are NULL or point to the described data; the particles stay as they are meanwhile.
MeniscusStatus meniscus_reconstruct(const struct MeniscusParticles *particles,
                                    const struct MeniscusOptions *options,
                                    struct MeniscusMesh **mesh);

// Reconstructs the surface of the particles in a file, or of a packed frame.
//
// `path`: any file that the program reads; one of several steps has a number behind a colon.
// Otherwise as meniscus_reconstruct.
//
// Pointers are NULL or point to the described data.
MeniscusStatus meniscus_reconstruct_file(const char *path,
                                         const struct MeniscusOptions *options,
                                         struct MeniscusMesh **mesh);

// Samples particles in memory once, for surfaces that may be drawn otherwise again and again.
//
// `frame`: where to put the frame, to be freed by meniscus_frame_free; NULL where it fails.
// Otherwise as meniscus_reconstruct. The particles are not needed any more afterwards.
//
// Pointers are NULL or point to the described data; the particles stay as they are meanwhile.
MeniscusStatus meniscus_sample(const struct MeniscusParticles *particles,
                               const struct MeniscusOptions *options,
                               struct MeniscusFrame **frame);

// Samples the particles in a file once, or opens a packed frame.
//
// Pointers are NULL or point to the described data.
MeniscusStatus meniscus_sample_file(const char *path,
                                    const struct MeniscusOptions *options,
                                    struct MeniscusFrame **frame);

// Draws a surface of a frame.
//
// `options`: NULL for the surface that was asked for when it was sampled. Else whatever does not
// need the particles again, from the width of smoothing to simplifying; what says how particles
// are sampled may be as it was, and is refused otherwise (MENISCUS_STATUS_REQUEST). Memory,
// threads, scratch folder and device stay those of the frame. Otherwise as meniscus_reconstruct.
//
// Pointers are NULL or point to the described data.
MeniscusStatus meniscus_frame_surface(const struct MeniscusFrame *frame,
                                      const struct MeniscusOptions *options,
                                      struct MeniscusMesh **mesh);

// Writes a frame to a .mnf file, whole or not at all, to be surfaced later by
// meniscus_reconstruct_file or meniscus_sample_file.
//
// `overwrite`: not 0 to replace a file that is there. `bytes`: NULL, or where to put the file's
// size.
//
// Pointers are NULL or valid as described.
MeniscusStatus meniscus_frame_pack(const struct MeniscusFrame *frame,
                                   const char *path,
                                   int32_t overwrite,
                                   uint64_t *bytes);

// Returns the number of doubts about the frame's particles; 0 of NULL.
//
// `frame` is NULL, or a handle that is not freed yet.
size_t meniscus_frame_warning_count(const struct MeniscusFrame *frame);

// Returns a doubt by its number from 0, for people; valid until the frame is freed. NULL where
// there is no such doubt.
//
// `frame` is NULL, or a handle that is not freed yet.
const char *meniscus_frame_warning(const struct MeniscusFrame *frame, size_t index);

// Frees a frame; NULL is ignored.
//
// `frame` is NULL, or a handle that is not freed yet.
void meniscus_frame_free(struct MeniscusFrame *frame);

// Starts threads for a simulation, of which nothing is known yet.
//
// `options` may be NULL for all defaults; its callback and what that is given have to be there
// until the simulation is freed. A callback ends one frame early, a handle also all that come
// later. `simulation`: where to put the handle, to be freed by meniscus_simulation_free; NULL
// where it fails.
//
// Pointers are NULL or point to the described data.
MeniscusStatus meniscus_simulation_new(const struct MeniscusOptions *options, struct MeniscusSimulation **simulation);

// Reconstructs the surface of the next frame.
//
// A frame without particles, or without a surface, is an empty mesh. Otherwise returns what
// meniscus_reconstruct does; the next frame may do better than one that fails.
// MENISCUS_STATUS_REQUEST while the simulation is at work on another frame.
//
// Pointers are NULL or point to the described data; the particles stay as they are meanwhile.
MeniscusStatus meniscus_simulation_frame(struct MeniscusSimulation *simulation,
                                         const struct MeniscusParticles *particles,
                                         struct MeniscusMesh **mesh);

// Returns 1 once cells, grid and calibration are frozen, else 0; 0 of NULL, and while a frame is
// made.
//
// `simulation` is NULL, or a handle that is not freed yet.
int32_t meniscus_simulation_is_settled(const struct MeniscusSimulation *simulation);

// Frees a simulation; NULL is ignored. Meshes that it made stay.
//
// `simulation` is NULL, or a handle that is not freed yet.
void meniscus_simulation_free(struct MeniscusSimulation *simulation);

// Frees a mesh, and all that it has lent; NULL is ignored.
//
// `mesh` is NULL, or a handle that is not freed yet.
void meniscus_mesh_free(struct MeniscusMesh *mesh);

// Returns the number of vertices; 0 of NULL.
//
// `mesh` is NULL, or a handle that is not freed yet.
uint64_t meniscus_mesh_vertex_count(const struct MeniscusMesh *mesh);

// Returns the number of triangles; 0 of NULL.
//
// `mesh` is NULL, or a handle that is not freed yet.
uint64_t meniscus_mesh_triangle_count(const struct MeniscusMesh *mesh);

// Returns 1 if vertices have normals, else 0; 0 of NULL.
//
// `mesh` is NULL, or a handle that is not freed yet.
int32_t meniscus_mesh_has_normals(const struct MeniscusMesh *mesh);

// Returns the number of attributes of the vertices, normals not among them; 0 of NULL.
//
// `mesh` is NULL, or a handle that is not freed yet.
size_t meniscus_mesh_attribute_count(const struct MeniscusMesh *mesh);

// Returns the name of an attribute by its number from 0, valid until the mesh is freed; NULL where
// there is no such attribute.
//
// `mesh` is NULL, or a handle that is not freed yet.
const char *meniscus_mesh_attribute_name(const struct MeniscusMesh *mesh, size_t index);

// Returns the numbers per vertex of an attribute by its number from 0; 0 where there is no such
// attribute.
//
// `mesh` is NULL, or a handle that is not freed yet.
uint64_t meniscus_mesh_attribute_components(const struct MeniscusMesh *mesh, size_t index);

// Copies the vertices' positions as float: 3 numbers a vertex.
//
// `capacity`: the numbers that `out` has room for, at least 3 times the vertices. Rounding to
// float moves vertices that are far from the origin.
//
// Pointers are NULL or valid as described.
MeniscusStatus meniscus_mesh_positions_f32(const struct MeniscusMesh *mesh, float *out, uint64_t capacity);

// Copies the vertices' positions as double: 3 numbers a vertex.
//
// `capacity`: the numbers that `out` has room for, at least 3 times the vertices.
//
// Pointers are NULL or valid as described.
MeniscusStatus meniscus_mesh_positions_f64(const struct MeniscusMesh *mesh, double *out, uint64_t capacity);

// Copies the triangles as uint32_t: 3 numbers a triangle, its vertices, counterclockwise seen from
// outside.
//
// `capacity`: the numbers that `out` has room for, at least 3 times the triangles.
// MENISCUS_STATUS_REQUEST for a mesh of more than 2^32 vertices.
//
// Pointers are NULL or valid as described.
MeniscusStatus meniscus_mesh_triangles_u32(const struct MeniscusMesh *mesh, uint32_t *out, uint64_t capacity);

// Copies the triangles as uint64_t: 3 numbers a triangle, its vertices, counterclockwise seen from
// outside.
//
// `capacity`: the numbers that `out` has room for, at least 3 times the triangles.
//
// Pointers are NULL or valid as described.
MeniscusStatus meniscus_mesh_triangles_u64(const struct MeniscusMesh *mesh, uint64_t *out, uint64_t capacity);

// Copies the vertices' normals: 3 numbers a vertex, of length 1, outward. MENISCUS_STATUS_REQUEST
// where none were asked for.
//
// `capacity`: the numbers that `out` has room for, at least 3 times the vertices.
//
// Pointers are NULL or valid as described.
MeniscusStatus meniscus_mesh_normals(const struct MeniscusMesh *mesh, float *out, uint64_t capacity);

// Returns 1 if an attribute by its number from 0 is of whole numbers, which
// meniscus_mesh_attribute_whole copies as they are; else 0, also where there is no such attribute.
//
// `mesh` is NULL, or a handle that is not freed yet.
int32_t meniscus_mesh_attribute_is_whole(const struct MeniscusMesh *mesh, size_t index);

// Copies an attribute of the vertices by its number from 0: all components of one vertex after the
// other. Whole numbers are rounded to float.
//
// `capacity`: the numbers that `out` has room for, at least the vertices times the components.
//
// Pointers are NULL or valid as described.
MeniscusStatus meniscus_mesh_attribute(const struct MeniscusMesh *mesh, size_t index, float *out, uint64_t capacity);

// Copies an attribute of whole numbers, such as identifiers, by its number from 0: all components
// of one vertex after the other. MENISCUS_STATUS_REQUEST for an attribute of other numbers.
//
// Numbers are from -2^31 to 2^31 - 1, or from 0 to 2^32 - 1. `capacity`: the numbers that `out` has
// room for, at least the vertices times the components.
//
// Pointers are NULL or valid as described.
MeniscusStatus meniscus_mesh_attribute_whole(const struct MeniscusMesh *mesh,
                                             size_t index,
                                             int64_t *out,
                                             uint64_t capacity);

// Lends the whole mesh, in memory that the library allocates with the first such call, and frees
// with the mesh. MENISCUS_STATUS_REQUEST for a mesh of more than 2^32 vertices.
//
// `mesh` is NULL, or a handle that is not freed yet; `arrays` is NULL or points to a structure of
// the size that it says.
MeniscusStatus meniscus_mesh_arrays(const struct MeniscusMesh *mesh, struct MeniscusArrays *arrays);

// Returns the number of doubts about the surface, or about the request for it; 0 of NULL.
//
// `mesh` is NULL, or a handle that is not freed yet.
size_t meniscus_mesh_warning_count(const struct MeniscusMesh *mesh);

// Returns a doubt by its number from 0, for people; valid until the mesh is freed. NULL where
// there is no such doubt.
//
// `mesh` is NULL, or a handle that is not freed yet.
const char *meniscus_mesh_warning(const struct MeniscusMesh *mesh, size_t index);

// Tells how the mesh was made.
//
// `mesh` is NULL, or a handle that is not freed yet; `report` is NULL or points to a structure of
// the size that it says.
MeniscusStatus meniscus_mesh_report(const struct MeniscusMesh *mesh, struct MeniscusReport *report);

// Checks that the mesh is closed, oriented and 2-manifold, and measures it. Takes memory for a
// copy of the mesh, as meniscus_mesh_arrays does.
//
// `mesh` is NULL, or a handle that is not freed yet; `check` is NULL or points to a structure of
// the size that it says.
MeniscusStatus meniscus_mesh_check(const struct MeniscusMesh *mesh, struct MeniscusCheck *check);

// Writes the mesh to a file whose extension says the format: whole or not at all, and the same
// bytes as the program writes.
//
// `overwrite`: not 0 to replace a file that is there. `bytes`: NULL, or where to put the file's
// size. The axis that points up and the compression are those of the options that the mesh was
// made by.
//
// Pointers are NULL or valid as described.
MeniscusStatus meniscus_mesh_write(const struct MeniscusMesh *mesh,
                                   const char *path,
                                   int32_t overwrite,
                                   uint64_t *bytes);

// Tells what the format of a file would make of the mesh that is worth a warning, in lines of
// text, and puts it into the caller's buffer, cut short where that is too small, and ended by a
// NUL.
//
// `text`: NULL, or room for `capacity` bytes. `length`: NULL, or where to put the bytes that the
// whole text takes, without the NUL: 0 where there is no warning.
//
// Pointers are NULL or valid as described.
MeniscusStatus meniscus_mesh_format_warnings(const struct MeniscusMesh *mesh,
                                             const char *path,
                                             char *text,
                                             size_t capacity,
                                             size_t *length);

// Makes options of which none is set, to be freed by meniscus_options_free.
struct MeniscusOptions *meniscus_options_new(void);

// Copies options, with their callbacks and their cancel handle, to be freed by
// meniscus_options_free. A copy of NULL has none set.
//
// `options` is NULL, or a handle that is not freed yet.
struct MeniscusOptions *meniscus_options_copy(const struct MeniscusOptions *options);

// Frees options; NULL is ignored.
//
// `options` is NULL, or a handle that is not freed yet.
void meniscus_options_free(struct MeniscusOptions *options);

// Sets an option from text, as on the command line: `meniscus_options_set(options, "domain",
// "0,0,-,1,2,-")`.
//
// Numbers have a '.' whatever the locale is. Numbers of a list are separated by commas or blanks,
// names by commas. Switches such as "normals" are "true" or "false". `value`: NULL returns the
// option to its default.
//
// MENISCUS_STATUS_REQUEST for an unknown key and for a value of another type: the message names
// the key, the value and the type that is expected, and the option keeps its value. A call that
// uses the options refuses numbers out of range, and options that exclude each other.
//
// Pointers are NULL or valid as described.
MeniscusStatus meniscus_options_set(struct MeniscusOptions *options, const char *key, const char *value);

// Sets an option from a number. A switch is 0 or 1. Otherwise as meniscus_options_set.
//
// Pointers are NULL or valid as described.
MeniscusStatus meniscus_options_set_number(struct MeniscusOptions *options, const char *key, double value);

// Sets an option from several numbers: 3 for a point, 6 for a box, its lowest corner first.
// -INFINITY and INFINITY leave an axis of a box open. Otherwise as meniscus_options_set.
//
// Pointers are NULL or valid as described; `values` points to `count` numbers.
MeniscusStatus meniscus_options_set_numbers(struct MeniscusOptions *options,
                                            const char *key,
                                            const double *values,
                                            size_t count);

// Sets the function that is called with the progress of a frame, and the pointer that it is given;
// a conversion calls none. NULL for no function.
//
// A simulation of meniscus_simulation_new calls it until that simulation is freed, any other call
// until the call returns.
//
// `options` is NULL, or a handle that is not freed yet.
MeniscusStatus meniscus_options_on_progress(struct MeniscusOptions *options,
                                            MeniscusProgressCallback progress,
                                            void *user);

// Sets the function that meniscus_convert calls with the events of a conversion, and the pointer
// that it is given. NULL for no function.
//
// `options` is NULL, or a handle that is not freed yet.
MeniscusStatus meniscus_options_on_event(struct MeniscusOptions *options, MeniscusEventCallback event, void *user);

// Sets the handle by which any thread can end the work early; NULL for none. The handle may be
// freed before the options are.
//
// If a callback ends the work, the handle counts as cancelled.
//
// Pointers are NULL, or handles that are not freed yet.
MeniscusStatus meniscus_options_cancel_by(struct MeniscusOptions *options, const struct MeniscusCancel *cancel);

// Returns the key of an option by its number from 0; NULL where there is no such option. The text
// lives for ever.
const char *meniscus_options_key(size_t index);

// Returns one line of help on an option by its number from 0; NULL where there is no such option.
// The text lives for ever.
const char *meniscus_options_help(size_t index);

// Makes sure, before the work, that a mesh could be written to `path`, whose extension says the
// format, and that the format can hold what is asked for. Leaves nothing there.
//
// `options` may be NULL for all defaults. `overwrite`: not 0 if a file that is there may be
// replaced.
//
// Pointers are NULL or valid as described.
MeniscusStatus meniscus_check_output(const char *path, const struct MeniscusOptions *options, int32_t overwrite);

// Returns the message of the last call of this thread that did not return MENISCUS_STATUS_OK: what
// is wrong, and where. Empty where there was none.
//
// Each thread has its own, so that threads do not see each other's. The text is the library's: it
// is valid until the next call on this thread fails, or the thread ends.
const char *meniscus_last_error(void);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* MENISCUS_H */
