//! Frames: particles to a surface in one call, or sampled once for several surfaces.

use std::ffi::{CString, c_char};
use std::path::Path;
use std::ptr::null;

use meniscus::{Frame, Reconstruction, Surface};

use crate::control::free;
use crate::mesh::MeniscusMesh;
use crate::options::{MeniscusOptions, RequestParts, replacing};
use crate::particles::{CallerParticles, MeniscusParticles};
use crate::status::{Failure, MeniscusStatus, Outcome, ask, c_text, call};
use crate::text::{path, put};

/// A sampled frame: the field of the particles, from which surfaces with different filters can be
/// made. Freed by meniscus_frame_free.
///
/// Several threads may use it at the same time, as long as none frees it.
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

/// Does work whose result is a handle: NULL on failure.
///
/// # Safety
/// `out` is NULL or points to a pointer.
pub unsafe fn making<T>(
    out: *mut *mut T,
    what: &str,
    work: impl FnOnce() -> Outcome<T>,
) -> MeniscusStatus {
    call(|| {
        if out.is_null() {
            return Err(Failure::request(format!("{what} is NULL")));
        }
        // SAFETY: as for this function.
        unsafe { put(out, std::ptr::null_mut()) };
        let made = Box::into_raw(Box::new(work()?));
        // SAFETY: as for this function.
        unsafe { put(out, made) };
        Ok(())
    })
}

/// Does work with particles in memory, with the callback active.
///
/// # Safety
/// Pointers are NULL or point to the described data.
unsafe fn of_particles<T>(
    particles: *const MeniscusParticles,
    options: *const MeniscusOptions,
    act: impl FnOnce(&Reconstruction, &CallerParticles) -> Result<T, meniscus::Error>,
) -> Outcome<T> {
    // SAFETY: as for this function.
    let (particles, asked) =
        unsafe { (CallerParticles::new(particles)?, RequestParts::new(options)?) };
    let asked = asked.on_machine(|_| Some(particles.bytes()))?;
    let _active = asked.control.activate();
    Ok(act(&asked.request, &particles)?)
}

/// Does work with a file, with the callback active.
///
/// # Safety
/// Pointers are NULL or point to the described data.
unsafe fn of_file<T>(
    file: *const c_char,
    options: *const MeniscusOptions,
    act: impl FnOnce(&Reconstruction, &Path) -> Result<T, meniscus::Error>,
) -> Outcome<T> {
    // SAFETY: as for this function.
    let (file, asked) = unsafe { (path(file, "path")?, RequestParts::new(options)?) };
    // Errors of the request are reported before a device is opened.
    asked.request.check(&file)?;
    let asked = asked.for_file(&file)?;
    let _active = asked.control.activate();
    Ok(act(&asked.request, &file)?)
}

/// Reconstructs the surface of particles in memory.
///
/// `options` may be NULL for all defaults. `mesh`: receives the mesh, to be freed by
/// meniscus_mesh_free; NULL on failure.
///
/// MENISCUS_STATUS_REQUEST for invalid arguments and options, and for too little memory;
/// MENISCUS_STATUS_INPUT for particles that are not finite or too far away, for no particles, and
/// if they have no surface; MENISCUS_STATUS_OUTPUT if scratch files fail.
///
/// Pointers are NULL or point to the described data; the particles stay unchanged meanwhile.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_reconstruct(
    particles: *const MeniscusParticles,
    options: *const MeniscusOptions,
    mesh: *mut *mut MeniscusMesh,
) -> MeniscusStatus {
    let surface = || {
        // SAFETY: as for this function.
        unsafe { of_particles(particles, options, |request, particles| request.run(particles)) }
    };
    // SAFETY: as for this function.
    unsafe { making(mesh, "mesh", || surface().map(MeniscusMesh::new)) }
}

/// Reconstructs the surface of the particles in a file, or of a packed frame.
///
/// `path`: any file that the program reads; `file#N` is a step of a file with several. Otherwise
/// like meniscus_reconstruct.
///
/// Pointers are NULL or point to the described data.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_reconstruct_file(
    path: *const c_char,
    options: *const MeniscusOptions,
    mesh: *mut *mut MeniscusMesh,
) -> MeniscusStatus {
    // SAFETY: as for this function.
    let surface = || unsafe { of_file(path, options, |request, file| request.run_file(file)) };
    // SAFETY: as for this function.
    unsafe { making(mesh, "mesh", || surface().map(MeniscusMesh::new)) }
}

/// Samples particles in memory once, for several surfaces with different settings.
///
/// `frame`: receives the frame, to be freed by meniscus_frame_free; NULL on failure. Otherwise like
/// meniscus_reconstruct. The particles are not needed any more afterwards.
///
/// Pointers are NULL or point to the described data; the particles stay unchanged meanwhile.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_sample(
    particles: *const MeniscusParticles,
    options: *const MeniscusOptions,
    frame: *mut *mut MeniscusFrame,
) -> MeniscusStatus {
    let sampled = || {
        // SAFETY: as for this function.
        unsafe { of_particles(particles, options, |request, particles| request.sample(particles)) }
    };
    // SAFETY: as for this function.
    unsafe { making(frame, "frame", || sampled().map(MeniscusFrame::new)) }
}

/// Samples the particles in a file once, or opens a packed frame.
///
/// Pointers are NULL or point to the described data.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_sample_file(
    path: *const c_char,
    options: *const MeniscusOptions,
    frame: *mut *mut MeniscusFrame,
) -> MeniscusStatus {
    // SAFETY: as for this function.
    let sampled =
        || unsafe { of_file(path, options, |request, file| request.open(file)?.sample()) };
    // SAFETY: as for this function.
    unsafe { making(frame, "frame", || sampled().map(MeniscusFrame::new)) }
}

/// The frame of a handle.
///
/// # Safety
/// `frame` is NULL or a handle that has not been freed.
unsafe fn of<'a>(frame: *const MeniscusFrame) -> Outcome<&'a MeniscusFrame> {
    // SAFETY: as for this function.
    unsafe { frame.as_ref() }.ok_or_else(|| Failure::request("frame is NULL"))
}

/// Makes a surface from a frame.
///
/// `options`: NULL for the surface that was requested when the particles were sampled. Otherwise,
/// settings from smoothing to simplifying; settings of the sampling must be unset or unchanged
/// (else MENISCUS_STATUS_REQUEST). Memory, threads, scratch folder and device remain those of the
/// frame. Otherwise like meniscus_reconstruct.
///
/// Pointers are NULL or point to the described data.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_frame_surface(
    frame: *const MeniscusFrame,
    options: *const MeniscusOptions,
    mesh: *mut *mut MeniscusMesh,
) -> MeniscusStatus {
    let surface = || -> Outcome<Surface> {
        // SAFETY: as for this function.
        let frame = &unsafe { of(frame) }?.frame;
        if options.is_null() {
            return Ok(frame.surface()?);
        }
        // SAFETY: as for this function.
        let asked = unsafe { RequestParts::new(options) }?;
        let _active = asked.control.activate();
        Ok(frame.surface_by(&asked.request)?)
    };
    // SAFETY: as for this function.
    unsafe { making(mesh, "mesh", || surface().map(MeniscusMesh::new)) }
}

/// Writes a frame to a .mnf file, completely or not at all, for meniscus_reconstruct_file or
/// meniscus_sample_file.
///
/// `overwrite`: not 0 to replace an existing file. `bytes`: NULL, or receives the file's size.
///
/// Pointers are NULL or valid as described.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_frame_pack(
    frame: *const MeniscusFrame,
    path: *const c_char,
    overwrite: i32,
    bytes: *mut u64,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: as for this function.
        let (frame, path) = unsafe { (of(frame)?, self::path(path, "path")?) };
        let output = Reconstruction::new().packed_output(&path, replacing(overwrite))?;
        let packed = frame.frame.pack(output)?;
        // SAFETY: as for this function.
        unsafe { put(bytes, packed.bytes) };
        Ok(())
    })
}

/// Returns the number of warnings about the frame's particles; 0 for NULL.
///
/// `frame` is NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_frame_warning_count(frame: *const MeniscusFrame) -> usize {
    // SAFETY: as for this function.
    unsafe { frame.as_ref() }.map_or(0, |frame| frame.warnings.len())
}

/// Returns a warning by its index, as text that is valid until the frame is freed; NULL if there is
/// no such warning.
///
/// `frame` is NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_frame_warning(
    frame: *const MeniscusFrame,
    index: usize,
) -> *const c_char {
    // SAFETY: as for this function.
    let frame = unsafe { frame.as_ref() };
    ask(null(), || {
        frame.and_then(|frame| frame.warnings.get(index)).map_or(null(), |text| text.as_ptr())
    })
}

/// Frees a frame; NULL is ignored.
///
/// `frame` is NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_frame_free(frame: *mut MeniscusFrame) {
    // SAFETY: as for this function.
    unsafe { free(frame) };
}
