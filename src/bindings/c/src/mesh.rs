//! Surfaces. The caller can copy their data into its own memory, read them in the library's memory,
//! or write them to files.

use std::ffi::{CString, c_char};
use std::path::Path;
use std::ptr::null;
use std::sync::OnceLock;

use meniscus::files::{AttributeInfo, MeshFormat};
use meniscus::mesh::{self, Mesh, Outline};
use meniscus::{Error, Surface};

use crate::control::free;
use crate::options::replacing;
use crate::report::{MeniscusCheck, MeniscusReport};
use crate::sized::{SizedStruct, check, fill};
use crate::status::{Failure, MeniscusStatus, Outcome, c_text, call, catch_panic};
use crate::text::{buffer, path, put};

/// A surface: a closed, oriented 2-manifold around the fluid. It must be freed by
/// meniscus_mesh_free.
///
/// Several threads may use a mesh at the same time, as long as no thread frees it.
pub struct MeniscusMesh {
    surface: Surface,
    outline: Outline,
    names: Vec<CString>,
    warnings: Vec<CString>,
    in_memory: OnceLock<MeshInMemory>,
}

/// The complete mesh in memory, for [`meniscus_mesh_arrays`].
struct MeshInMemory {
    mesh: Mesh,
    attributes: Vec<MeniscusMeshAttribute>,
}

// SAFETY: the pointers in `attributes` point into `mesh` and to the names of the `MeniscusMesh`.
// Both live as long as this struct, and never change.
unsafe impl Send for MeshInMemory {}
// SAFETY: for the same reason as `Send`.
unsafe impl Sync for MeshInMemory {}

/// A vertex attribute, in memory that belongs to the mesh.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct MeniscusMeshAttribute {
    /// The name of the attribute.
    pub name: *const c_char,
    /// `components` numbers per vertex, vertex by vertex. Integers are rounded to float;
    /// meniscus_mesh_attribute_whole copies their exact values.
    pub values: *const f32,
    /// Numbers per vertex.
    pub components: u64,
}

/// A mesh in the library's memory. The caller sets `size`, and the library sets the other fields.
/// All pointers are valid until the mesh is freed. The pointer of an empty array is NULL.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct MeniscusArrays {
    /// sizeof(MeniscusArrays).
    pub size: usize,
    /// Number of vertices.
    pub vertex_count: u64,
    /// Number of triangles.
    pub triangle_count: u64,
    /// 3 numbers per vertex: x, y, z, in the unit of the particles' positions.
    pub positions: *const f64,
    /// 3 numbers per triangle: the indices of its vertices, counterclockwise when seen from
    /// outside.
    pub triangles: *const u32,
    /// 3 numbers per vertex: the outward unit normal; NULL if no normals were requested.
    pub normals: *const f32,
    /// The vertex attributes; the normals are not among them.
    pub attributes: *const MeniscusMeshAttribute,
    /// Number of elements in `attributes`.
    pub attribute_count: usize,
}

// SAFETY: all fields are numbers or nullable pointers.
unsafe impl SizedStruct for MeniscusArrays {
    const NAME: &str = "MeniscusArrays";
}

/// The address of an array, or NULL if it is empty.
fn address<T>(of: &[T]) -> *const T {
    if of.is_empty() { null() } else { of.as_ptr() }
}

impl MeniscusMesh {
    pub fn new(surface: Surface) -> Self {
        let outline = surface.mesh().outline();
        let report = surface.report();
        let warnings = report.warnings.iter().map(ToString::to_string);
        Self {
            names: outline.attributes.iter().map(|info| c_text(info.name.as_str())).collect(),
            warnings: warnings.map(c_text).collect(),
            outline,
            surface,
            in_memory: OnceLock::new(),
        }
    }

    /// Returns the complete mesh in memory. The first call creates it.
    fn mesh_in_memory(&self) -> Outcome<&MeshInMemory> {
        if let Some(existing) = self.in_memory.get() {
            return Ok(existing);
        }
        let mesh = self.surface.to_mesh()?;
        let attribute =
            |(attribute, name): (&mesh::VertexAttribute, &CString)| MeniscusMeshAttribute {
                name: name.as_ptr(),
                values: address(&attribute.values),
                components: attribute.components as u64,
            };
        let attributes = mesh.attributes.iter().zip(&self.names).map(attribute).collect();
        // If another thread has already stored a copy of the mesh, `get_or_init` returns that copy.
        Ok(self.in_memory.get_or_init(|| MeshInMemory { mesh, attributes }))
    }

    /// Copies the mesh's values into the buffer `out`, which must have room for `needed` values.
    /// Calls `each` with the number of every piece of the mesh; `each` passes the values of this
    /// piece to its second argument.
    ///
    /// # Safety
    /// The requirements of [`buffer`].
    unsafe fn copy<T>(
        &self,
        out: (*mut T, u64),
        needed: u64,
        each: impl Fn(usize, &mut dyn FnMut(T)) -> std::io::Result<()>,
    ) -> Outcome {
        // SAFETY: the caller upholds this function's contract.
        let mut left = unsafe { buffer(out.0, out.1, needed, "out") }?.iter_mut();
        let mut put = |value: T| {
            left.next().map(|place| place.write(value));
        };
        for piece in 0..self.outline.pieces {
            let read = each(piece, &mut put);
            read.map_err(|fault| Failure {
                status: MeniscusStatus::Output,
                message: format!("cannot use a scratch file: {fault}"),
            })?;
        }
        Ok(())
    }

    unsafe fn copy_positions<T>(&self, out: (*mut T, u64), number: impl Fn(f64) -> T) -> Outcome {
        let each = |piece, put: &mut dyn FnMut(T)| {
            let vertices = self.surface.mesh().vertices(piece)?;
            vertices.positions.as_flattened().iter().for_each(|&x| put(number(x)));
            Ok(())
        };
        // SAFETY: the caller upholds this function's contract.
        unsafe { self.copy(out, self.outline.vertices.saturating_mul(3), each) }
    }

    /// Returns the attribute with this index, or an error if there is no such attribute.
    fn attribute(&self, index: usize) -> Outcome<&AttributeInfo> {
        let count = self.names.len();
        let missing = || {
            Failure::request(format!(
                "attribute index {index} is out of range (number of attributes: {count})"
            ))
        };
        self.outline.attributes.get(index).ok_or_else(missing)
    }

    unsafe fn copy_attribute<T>(
        &self,
        index: usize,
        out: (*mut T, u64),
        number: impl Fn(f32) -> T,
    ) -> Outcome {
        let each = |piece, put: &mut dyn FnMut(T)| {
            let vertices = self.surface.mesh().vertices(piece)?;
            vertices.attributes[index].iter().for_each(|&word| put(number(word)));
            Ok(())
        };
        let components = self.attribute(index)?.components as u64;
        // SAFETY: the caller upholds this function's contract.
        unsafe { self.copy(out, self.outline.vertices.saturating_mul(components), each) }
    }

    unsafe fn copy_triangles<T>(&self, out: (*mut T, u64), number: impl Fn(u64) -> T) -> Outcome {
        let each = |piece, put: &mut dyn FnMut(T)| {
            let triangles = self.surface.mesh().triangles(piece)?;
            triangles.as_flattened().iter().for_each(|&vertex| put(number(vertex)));
            Ok(())
        };
        // SAFETY: the caller upholds this function's contract.
        unsafe { self.copy(out, self.outline.triangles.saturating_mul(3), each) }
    }
}

/// Returns the mesh of a handle, or an error if the handle is NULL.
///
/// # Safety
/// `mesh` must be NULL or a handle that has not been freed.
unsafe fn mesh_of<'a>(mesh: *const MeniscusMesh) -> Outcome<&'a MeniscusMesh> {
    // SAFETY: the caller upholds this function's contract.
    unsafe { mesh.as_ref() }.ok_or_else(|| Failure::request("mesh is NULL"))
}

/// Returns the result of the query `what`, or `none` if the handle is NULL.
///
/// # Safety
/// The requirements of [`mesh_of`].
unsafe fn query<T: Copy>(
    mesh: *const MeniscusMesh,
    none: T,
    what: impl FnOnce(&MeniscusMesh) -> T,
) -> T {
    // SAFETY: the caller upholds this function's contract.
    unsafe { mesh.as_ref() }.map_or(none, |mesh| catch_panic(none, || what(mesh)))
}

/// Frees a mesh, including its arrays, names and warnings; NULL is ignored.
///
/// `mesh` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_free(mesh: *mut MeniscusMesh) {
    // SAFETY: the caller upholds this function's contract.
    unsafe { free(mesh) };
}

/// Returns the number of vertices; 0 for NULL.
///
/// `mesh` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_vertex_count(mesh: *const MeniscusMesh) -> u64 {
    // SAFETY: the caller upholds this function's contract.
    unsafe { query(mesh, 0, |mesh| mesh.outline.vertices) }
}

/// Returns the number of triangles; 0 for NULL.
///
/// `mesh` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_triangle_count(mesh: *const MeniscusMesh) -> u64 {
    // SAFETY: the caller upholds this function's contract.
    unsafe { query(mesh, 0, |mesh| mesh.outline.triangles) }
}

/// Returns 1 if the vertices have normals, and 0 otherwise; 0 for NULL.
///
/// `mesh` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_has_normals(mesh: *const MeniscusMesh) -> i32 {
    // SAFETY: the caller upholds this function's contract.
    unsafe { query(mesh, 0, |mesh| mesh.outline.normals.into()) }
}

/// Returns the number of vertex attributes, not counting normals; 0 for NULL.
///
/// `mesh` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_attribute_count(mesh: *const MeniscusMesh) -> usize {
    // SAFETY: the caller upholds this function's contract.
    unsafe { query(mesh, 0, |mesh| mesh.names.len()) }
}

/// Returns the name of the attribute with this index, or NULL if there is no such attribute. The
/// name is valid until the mesh is freed.
///
/// `mesh` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_attribute_name(
    mesh: *const MeniscusMesh,
    index: usize,
) -> *const c_char {
    // SAFETY: the caller upholds this function's contract.
    unsafe {
        query(mesh, null(), |mesh| mesh.names.get(index).map_or(null(), |name| name.as_ptr()))
    }
}

/// Returns the number of components of the attribute with this index; 0 if there is no such
/// attribute.
///
/// `mesh` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_attribute_components(
    mesh: *const MeniscusMesh,
    index: usize,
) -> u64 {
    // SAFETY: the caller upholds this function's contract.
    unsafe {
        query(mesh, 0, |mesh| {
            mesh.outline.attributes.get(index).map_or(0, |info| info.components as u64)
        })
    }
}

/// Copies the vertices' positions as float: 3 numbers per vertex.
///
/// `capacity`: how many numbers fit into `out`, at least 3 per vertex. Far from the origin,
/// rounding to float moves vertices visibly.
///
/// Pointers must be NULL or valid as described.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_positions_f32(
    mesh: *const MeniscusMesh,
    out: *mut f32,
    capacity: u64,
) -> MeniscusStatus {
    // SAFETY: the caller upholds this function's contract.
    call(|| unsafe { mesh_of(mesh)?.copy_positions((out, capacity), |x| x as f32) })
}

/// Copies the vertices' positions as double: 3 numbers per vertex.
///
/// `capacity`: how many numbers fit into `out`, at least 3 per vertex.
///
/// Pointers must be NULL or valid as described.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_positions_f64(
    mesh: *const MeniscusMesh,
    out: *mut f64,
    capacity: u64,
) -> MeniscusStatus {
    // SAFETY: the caller upholds this function's contract.
    call(|| unsafe { mesh_of(mesh)?.copy_positions((out, capacity), |x| x) })
}

/// Copies the triangles as uint32_t: the indices of the 3 vertices of each triangle,
/// counterclockwise when seen from outside.
///
/// `capacity`: how many numbers fit into `out`, at least 3 per triangle. Returns
/// MENISCUS_STATUS_REQUEST for a mesh of more than 2^32 vertices.
///
/// Pointers must be NULL or valid as described.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_triangles_u32(
    mesh: *const MeniscusMesh,
    out: *mut u32,
    capacity: u64,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: the caller upholds this function's contract.
        let mesh = unsafe { mesh_of(mesh) }?;
        let vertices = mesh.outline.vertices;
        if vertices > 1 << 32 {
            return Err(Failure::request(format!(
                "the indices of {vertices} vertices do not fit in 32 bits; use \
                 meniscus_mesh_triangles_u64"
            )));
        }
        // SAFETY: the caller upholds this function's contract.
        unsafe { mesh.copy_triangles((out, capacity), |vertex| vertex as u32) }
    })
}

/// Copies the triangles as uint64_t: the indices of the 3 vertices of each triangle,
/// counterclockwise when seen from outside.
///
/// `capacity`: how many numbers fit into `out`, at least 3 per triangle.
///
/// Pointers must be NULL or valid as described.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_triangles_u64(
    mesh: *const MeniscusMesh,
    out: *mut u64,
    capacity: u64,
) -> MeniscusStatus {
    // SAFETY: the caller upholds this function's contract.
    call(|| unsafe { mesh_of(mesh)?.copy_triangles((out, capacity), |vertex| vertex) })
}

/// Copies the vertices' outward unit normals: 3 numbers per vertex. Returns MENISCUS_STATUS_REQUEST
/// if no normals were requested.
///
/// `capacity`: how many numbers fit into `out`, at least 3 per vertex.
///
/// Pointers must be NULL or valid as described.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_normals(
    mesh: *const MeniscusMesh,
    out: *mut f32,
    capacity: u64,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: the caller upholds this function's contract.
        let mesh = unsafe { mesh_of(mesh) }?;
        if !mesh.outline.normals {
            return Err(Failure::request("the mesh has no normals; set the option normals"));
        }
        let each = |piece, put: &mut dyn FnMut(f32)| {
            let vertices = mesh.surface.mesh().vertices(piece)?;
            vertices.normals.as_flattened().iter().for_each(|&x| put(x));
            Ok(())
        };
        // SAFETY: the caller upholds this function's contract.
        unsafe { mesh.copy((out, capacity), mesh.outline.vertices.saturating_mul(3), each) }
    })
}

/// Returns 1 if the attribute with this index holds integers, and 0 if it holds other numbers or
/// does not exist. meniscus_mesh_attribute_whole copies the exact values of integers.
///
/// `mesh` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_attribute_is_whole(
    mesh: *const MeniscusMesh,
    index: usize,
) -> i32 {
    // SAFETY: the caller upholds this function's contract.
    unsafe {
        query(mesh, 0, |mesh| {
            mesh.outline.attributes.get(index).is_some_and(|info| info.kind.is_whole()).into()
        })
    }
}

/// Copies the vertex attribute with this index: all components of the first vertex, then those of
/// the second, and so on. Integers are rounded to float.
///
/// `capacity`: how many numbers fit into `out`, at least the number of vertices times the number of
/// components.
///
/// Pointers must be NULL or valid as described.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_attribute(
    mesh: *const MeniscusMesh,
    index: usize,
    out: *mut f32,
    capacity: u64,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: the caller upholds this function's contract.
        let mesh = unsafe { mesh_of(mesh) }?;
        let kind = mesh.attribute(index)?.kind;
        // SAFETY: the caller upholds this function's contract.
        unsafe { mesh.copy_attribute(index, (out, capacity), |word| kind.number(word)) }
    })
}

/// Copies the vertex attribute with this index, which must hold integers, such as identifiers: all
/// components of the first vertex, then those of the second, and so on. Returns
/// MENISCUS_STATUS_REQUEST for other attributes.
///
/// Values are from -2^31 to 2^31 - 1, or from 0 to 2^32 - 1. `capacity`: how many numbers fit into
/// `out`, at least the number of vertices times the number of components.
///
/// Pointers must be NULL or valid as described.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_attribute_whole(
    mesh: *const MeniscusMesh,
    index: usize,
    out: *mut i64,
    capacity: u64,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: the caller upholds this function's contract.
        let mesh = unsafe { mesh_of(mesh) }?;
        let info = mesh.attribute(index)?;
        if !info.kind.is_whole() {
            return Err(Failure::request(format!(
                "{}: the attribute has floating-point numbers; use meniscus_mesh_attribute",
                info.name
            )));
        }
        // SAFETY: the caller upholds this function's contract.
        unsafe { mesh.copy_attribute(index, (out, capacity), |word| info.kind.whole(word)) }
    })
}

/// Returns pointers to the complete mesh, in memory that the first call allocates. Freeing the mesh
/// also frees this memory. Returns MENISCUS_STATUS_REQUEST for a mesh of more than 2^32 vertices.
///
/// `mesh` must be NULL or a handle that has not been freed; `arrays` must be NULL or point to a
/// structure whose first field holds its size.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_arrays(
    mesh: *const MeniscusMesh,
    arrays: *mut MeniscusArrays,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: the caller upholds this function's contract.
        let mesh = unsafe { mesh_of(mesh) }?;
        // Check the argument before the expensive copy of the mesh.
        // SAFETY: the caller upholds this function's contract.
        unsafe { check(arrays, "arrays") }?;
        let MeshInMemory { mesh, attributes } = mesh.mesh_in_memory()?;
        let filled = MeniscusArrays {
            size: size_of::<MeniscusArrays>(),
            vertex_count: mesh.positions.len() as u64,
            triangle_count: mesh.triangles.len() as u64,
            positions: address(&mesh.positions).cast(),
            triangles: address(&mesh.triangles).cast(),
            normals: mesh.normals.as_ref().map_or(null(), |normals| address(normals).cast()),
            attributes: address(attributes),
            attribute_count: attributes.len(),
        };
        // SAFETY: the caller upholds this function's contract.
        unsafe { fill(arrays, filled, "arrays") }
    })
}

/// Returns the number of warnings about the surface and about the request for it; 0 for NULL.
///
/// `mesh` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_warning_count(mesh: *const MeniscusMesh) -> usize {
    // SAFETY: the caller upholds this function's contract.
    unsafe { query(mesh, 0, |mesh| mesh.warnings.len()) }
}

/// Returns the warning with this index, or NULL if there is no such warning. The text is valid
/// until the mesh is freed.
///
/// `mesh` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_warning(
    mesh: *const MeniscusMesh,
    index: usize,
) -> *const c_char {
    // SAFETY: the caller upholds this function's contract.
    unsafe {
        query(mesh, null(), |mesh| mesh.warnings.get(index).map_or(null(), |text| text.as_ptr()))
    }
}

/// Reports how the mesh was reconstructed.
///
/// `mesh` must be NULL or a handle that has not been freed; `report` must be NULL or point to a
/// structure whose first field holds its size.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_report(
    mesh: *const MeniscusMesh,
    report: *mut MeniscusReport,
) -> MeniscusStatus {
    // SAFETY: the caller upholds this function's contract.
    call(|| unsafe { fill(report, mesh_of(mesh)?.surface.report().into(), "report") })
}

/// Checks that the mesh is closed, oriented and 2-manifold, and measures it. Like
/// meniscus_mesh_arrays, this function needs memory for a copy of the mesh.
///
/// `mesh` must be NULL or a handle that has not been freed; `check` must be NULL or point to a
/// structure whose first field holds its size.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_check(
    mesh: *const MeniscusMesh,
    check: *mut MeniscusCheck,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: the caller upholds this function's contract.
        let mesh = unsafe { mesh_of(mesh) }?;
        // SAFETY: the caller upholds this function's contract.
        unsafe { self::check(check, "check") }?;
        let whole = &mesh.mesh_in_memory()?.mesh;
        let (found, measures) = on_threads(mesh.surface.report().threads, || {
            (mesh::check(whole), mesh::measure(whole))
        })?;
        // SAFETY: the caller upholds this function's contract.
        unsafe { fill(check, MeniscusCheck::new(&found, &measures), "check") }
    })
}

/// Writes the mesh to a file whose extension selects the format. The file appears completely or not
/// at all, and contains the same bytes as a file that the program writes.
///
/// `overwrite`: nonzero to replace an existing file. `bytes`: NULL, or receives the file's size in
/// bytes. The up axis and the compression are those of the options with which the mesh was
/// reconstructed.
///
/// Pointers must be NULL or valid as described.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_write(
    mesh: *const MeniscusMesh,
    path: *const c_char,
    overwrite: i32,
    bytes: *mut u64,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: the caller upholds this function's contract.
        let (mesh, path) = unsafe { (mesh_of(mesh)?, self::path(path, "path")?) };
        let written = match replacing(overwrite) {
            meniscus::files::Replace::Allow => mesh.surface.overwrite(&path)?,
            _ => mesh.surface.write(&path)?,
        };
        // SAFETY: the caller upholds this function's contract.
        unsafe { put(bytes, written) };
        Ok(())
    })
}

/// Copies the warnings that apply to writing the mesh to `path` into the caller's buffer, one per
/// line. The extension of `path` selects the format; the function writes no file. The text ends
/// with a NUL, and is truncated if the buffer is too small.
///
/// `text`: NULL, or a buffer of `capacity` bytes. `length`: NULL, or receives the length, in bytes,
/// of the whole text without the NUL; 0 if there are no warnings.
///
/// Pointers must be NULL or valid as described.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_mesh_format_warnings(
    mesh: *const MeniscusMesh,
    path: *const c_char,
    text: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: the caller upholds this function's contract.
        let (mesh, path) = unsafe { (mesh_of(mesh)?, self::path(path, "path")?) };
        let warnings = mesh.surface.warnings_in(format(&path)?)?;
        let lines: Vec<String> = warnings.iter().map(ToString::to_string).collect();
        let lines = c_text(lines.join("\n"));
        // SAFETY: the caller upholds this function's contract.
        unsafe { put(length, lines.as_bytes().len()) };
        if !text.is_null() && capacity > 0 {
            let kept = lines.as_bytes().len().min(capacity - 1);
            // SAFETY: `kept` bytes and the NUL fit into the `capacity` bytes of the caller's
            // buffer.
            unsafe {
                std::ptr::copy_nonoverlapping(lines.as_ptr(), text, kept);
                text.add(kept).write(0);
            }
        }
        Ok(())
    })
}

/// Runs `act` on `count` temporary threads, because the process's own threads belong to the caller.
fn on_threads<T: Send>(count: usize, act: impl FnOnce() -> T + Send) -> Outcome<T> {
    let threads = rayon::ThreadPoolBuilder::new().num_threads(count).build();
    let threads = threads.map_err(|fault| Error::Threads(fault.to_string()))?;
    Ok(threads.install(act))
}

fn format(path: &Path) -> Outcome<MeshFormat> {
    let known = MeshFormat::KNOWN;
    let unknown =
        || Failure::request(format!("{}: unknown extension; supported: {known}", path.display()));
    MeshFormat::of(path).ok_or_else(unknown)
}
