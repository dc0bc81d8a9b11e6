//! Frames of particles, which are reconstructed in one call, or sampled once for several surfaces.

use std::ffi::{CString, c_char};
use std::path::Path;
use std::ptr::null;

use meniscus::{Frame, Reconstruction, Surface};

use crate::control::free;
use crate::mesh::MeniscusMesh;
use crate::options::{MeniscusOptions, RequestParts, replacing};
use crate::particles::{CallerParticles, MeniscusParticles};
use crate::status::{Failure, MeniscusStatus, Outcome, c_text, call, catch_panic};
use crate::text::{path, put};

/// A sampled frame, from which surfaces with different filters can be computed. It must be freed by
/// meniscus_frame_free.
///
/// Several threads may use a frame at the same time, as long as no thread frees it.
pub struct MeniscusFrame {
    frame: Frame,
    warnings: Vec<CString>,
}

impl MeniscusFrame {
    fn new(frame: Frame) -> Self {
        let warnings = frame.warnings().iter().map(|warning| c_text(warning.to_string())).collect();
        Self { frame, warnings }
    }
}

/// Runs `work` and stores a handle to its result in `out`. On failure, stores NULL.
///
/// # Safety
/// `out` must be NULL or point to a pointer.
pub unsafe fn store_handle<T>(
    out: *mut *mut T,
    what: &str,
    work: impl FnOnce() -> Outcome<T>,
) -> MeniscusStatus {
    call(|| {
        if out.is_null() {
            return Err(Failure::request(format!("{what} is NULL")));
        }
        // SAFETY: the caller upholds this function's contract.
        unsafe { put(out, std::ptr::null_mut()) };
        let made = Box::into_raw(Box::new(work()?));
        // SAFETY: the caller upholds this function's contract.
        unsafe { put(out, made) };
        Ok(())
    })
}

/// Runs `act` with the caller's particles, while the progress callback is active.
///
/// # Safety
/// Pointers must be NULL or point to the described data.
unsafe fn with_particles<T>(
    particles: *const MeniscusParticles,
    options: *const MeniscusOptions,
    act: impl FnOnce(&Reconstruction, &CallerParticles) -> Result<T, meniscus::Error>,
) -> Outcome<T> {
    // SAFETY: the caller upholds this function's contract.
    let (particles, parts) =
        unsafe { (CallerParticles::new(particles)?, RequestParts::new(options)?) };
    let parts = parts.on_machine(|_| Some(particles.bytes()))?;
    let _active = parts.control.activate();
    Ok(act(&parts.request, &particles)?)
}

/// Runs `act` with a file, while the progress callback is active.
///
/// # Safety
/// Pointers must be NULL or point to the described data.
unsafe fn with_file<T>(
    file: *const c_char,
    options: *const MeniscusOptions,
    act: impl FnOnce(&Reconstruction, &Path) -> Result<T, meniscus::Error>,
) -> Outcome<T> {
    // SAFETY: the caller upholds this function's contract.
    let (file, parts) = unsafe { (path(file, "path")?, RequestParts::new(options)?) };
    // Report errors in the request before a device is opened.
    parts.request.check(&file)?;
    let parts = parts.for_file(&file)?;
    let _active = parts.control.activate();
    Ok(act(&parts.request, &file)?)
}

/// Reconstructs the surface of particles in memory.
///
/// If `options` is NULL, all options have their defaults. `mesh`: receives the mesh, which must be
/// freed by meniscus_mesh_free, or NULL on failure.
///
/// Returns MENISCUS_STATUS_REQUEST if arguments or options are invalid, or if the memory is not
/// sufficient. Returns MENISCUS_STATUS_INPUT if there are no particles, if the particles have no
/// surface, or if the option "skip-invalid" is not set and a position is not finite, too far from
/// the grid's origin, or more than one spacing outside the periodic box. Returns
/// MENISCUS_STATUS_OUTPUT if scratch files cannot be written.
///
/// Pointers must be NULL or point to the described data; the particles must not change during the
/// call.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_reconstruct(
    particles: *const MeniscusParticles,
    options: *const MeniscusOptions,
    mesh: *mut *mut MeniscusMesh,
) -> MeniscusStatus {
    let surface = || {
        // SAFETY: the caller upholds this function's contract.
        unsafe { with_particles(particles, options, |request, particles| request.run(particles)) }
    };
    // SAFETY: the caller upholds this function's contract.
    unsafe { store_handle(mesh, "mesh", || surface().map(MeniscusMesh::new)) }
}

/// Reconstructs the surface of a file's particles, or of a packed frame.
///
/// `path`: any file that the program reads; `file#N` selects step N of a file with several steps.
/// In all other respects, the function works like meniscus_reconstruct.
///
/// Pointers must be NULL or point to the described data.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_reconstruct_file(
    path: *const c_char,
    options: *const MeniscusOptions,
    mesh: *mut *mut MeniscusMesh,
) -> MeniscusStatus {
    // SAFETY: the caller upholds this function's contract.
    let surface = || unsafe { with_file(path, options, |request, file| request.run_file(file)) };
    // SAFETY: the caller upholds this function's contract.
    unsafe { store_handle(mesh, "mesh", || surface().map(MeniscusMesh::new)) }
}

/// Samples particles in memory once, for several surfaces with different settings.
///
/// `frame`: receives the frame, which must be freed by meniscus_frame_free, or NULL on failure.
/// After the call, the frame no longer needs the particles. In all other respects, the function
/// works like meniscus_reconstruct.
///
/// Pointers must be NULL or point to the described data; the particles must not change during the
/// call.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_sample(
    particles: *const MeniscusParticles,
    options: *const MeniscusOptions,
    frame: *mut *mut MeniscusFrame,
) -> MeniscusStatus {
    let sampled = || {
        // SAFETY: the caller upholds this function's contract.
        unsafe {
            with_particles(particles, options, |request, particles| request.sample(particles))
        }
    };
    // SAFETY: the caller upholds this function's contract.
    unsafe { store_handle(frame, "frame", || sampled().map(MeniscusFrame::new)) }
}

/// Samples a file's particles once, or opens a packed frame.
///
/// Pointers must be NULL or point to the described data.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_sample_file(
    path: *const c_char,
    options: *const MeniscusOptions,
    frame: *mut *mut MeniscusFrame,
) -> MeniscusStatus {
    // SAFETY: the caller upholds this function's contract.
    let sampled =
        || unsafe { with_file(path, options, |request, file| request.open(file)?.sample()) };
    // SAFETY: the caller upholds this function's contract.
    unsafe { store_handle(frame, "frame", || sampled().map(MeniscusFrame::new)) }
}

/// Returns the frame of a handle, or an error if the handle is NULL.
///
/// # Safety
/// `frame` must be NULL or a handle that has not been freed.
unsafe fn frame_of<'a>(frame: *const MeniscusFrame) -> Outcome<&'a MeniscusFrame> {
    // SAFETY: the caller upholds this function's contract.
    unsafe { frame.as_ref() }.ok_or_else(|| Failure::request("frame is NULL"))
}

/// Computes a surface from a sampled frame.
///
/// `options`: NULL for the surface that was requested when the particles were sampled. Otherwise,
/// the options can change the settings of the surface, such as "smooth", "normals" or "simplify".
/// Settings that affect the sampling must be unset or the same as before; otherwise, the function
/// returns MENISCUS_STATUS_REQUEST. The memory limit, the threads, the scratch folder and the
/// device are always those of the frame. In all other respects, the function works like
/// meniscus_reconstruct.
///
/// Pointers must be NULL or point to the described data.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_frame_surface(
    frame: *const MeniscusFrame,
    options: *const MeniscusOptions,
    mesh: *mut *mut MeniscusMesh,
) -> MeniscusStatus {
    let surface = || -> Outcome<Surface> {
        // SAFETY: the caller upholds this function's contract.
        let frame = &unsafe { frame_of(frame) }?.frame;
        if options.is_null() {
            return Ok(frame.surface()?);
        }
        // SAFETY: the caller upholds this function's contract.
        let parts = unsafe { RequestParts::new(options) }?;
        let _active = parts.control.activate();
        Ok(frame.surface_by(&parts.request)?)
    };
    // SAFETY: the caller upholds this function's contract.
    unsafe { store_handle(mesh, "mesh", || surface().map(MeniscusMesh::new)) }
}

/// Packs a frame into a .mnf file, which meniscus_reconstruct_file and meniscus_sample_file can
/// read. The file appears completely or not at all.
///
/// `overwrite`: nonzero to replace an existing file. `bytes`: NULL, or receives the file's size in
/// bytes.
///
/// Pointers must be NULL or valid as described.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_frame_pack(
    frame: *const MeniscusFrame,
    path: *const c_char,
    overwrite: i32,
    bytes: *mut u64,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: the caller upholds this function's contract.
        let (frame, path) = unsafe { (frame_of(frame)?, self::path(path, "path")?) };
        let output = Reconstruction::new().packed_output(&path, replacing(overwrite))?;
        let packed = frame.frame.pack(output)?;
        // SAFETY: the caller upholds this function's contract.
        unsafe { put(bytes, packed.bytes) };
        Ok(())
    })
}

/// Returns the number of warnings about the frame's particles; 0 for NULL.
///
/// `frame` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_frame_warning_count(frame: *const MeniscusFrame) -> usize {
    // SAFETY: the caller upholds this function's contract.
    unsafe { frame.as_ref() }.map_or(0, |frame| frame.warnings.len())
}

/// Returns the warning with this index, or NULL if there is no such warning. The text is valid
/// until the frame is freed.
///
/// `frame` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_frame_warning(
    frame: *const MeniscusFrame,
    index: usize,
) -> *const c_char {
    // SAFETY: the caller upholds this function's contract.
    let frame = unsafe { frame.as_ref() };
    catch_panic(null(), || {
        frame.and_then(|frame| frame.warnings.get(index)).map_or(null(), |text| text.as_ptr())
    })
}

/// Frees a frame; NULL is ignored.
///
/// `frame` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_frame_free(frame: *mut MeniscusFrame) {
    // SAFETY: the caller upholds this function's contract.
    unsafe { free(frame) };
}
