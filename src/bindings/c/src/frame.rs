//! Frames: particles to a surface at once, or sampled once and surfaced as often as one likes.

use std::ffi::{CString, c_char};
use std::path::Path;
use std::ptr::null;

use meniscus::{Frame, Reconstruction, Surface};

use crate::control::free;
use crate::mesh::MeniscusMesh;
use crate::options::{Asked, MeniscusOptions, replacing};
use crate::particles::{Borrowed, MeniscusParticles};
use crate::status::{Failure, MeniscusStatus, Outcome, ask, c_text, call};
use crate::text::{path, tell};

/// A frame that was sampled: particles as a field, from which surfaces are drawn by other filters
/// without the particles. Freed by meniscus_frame_free.
///
/// Several threads may use it at once, as long as none frees it.
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

/// Does work whose result is a handle: NULL where it fails.
///
/// # Safety
/// `out` is NULL, or points to a pointer.
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
        unsafe { tell(out, std::ptr::null_mut()) };
        let made = Box::into_raw(Box::new(work()?));
        // SAFETY: as for this function.
        unsafe { tell(out, made) };
        Ok(())
    })
}

/// Does something with particles in memory, while the callback listens.
///
/// # Safety
/// Pointers are NULL or point to the described data.
unsafe fn of_particles<T>(
    particles: *const MeniscusParticles,
    options: *const MeniscusOptions,
    act: impl FnOnce(&Reconstruction, &Borrowed) -> Result<T, meniscus::Error>,
) -> Outcome<T> {
    // SAFETY: as for this function.
    let (particles, asked) = unsafe { (Borrowed::new(particles)?, Asked::new(options)?) };
    let asked = asked.on_machine(|_| Some(particles.bytes()))?;
    let _listening = asked.control.listen();
    Ok(act(&asked.request, &particles)?)
}

/// Does something with a file, while the callback listens.
///
/// # Safety
/// Pointers are NULL or point to the described data.
unsafe fn of_file<T>(
    file: *const c_char,
    options: *const MeniscusOptions,
    act: impl FnOnce(&Reconstruction, &Path) -> Result<T, meniscus::Error>,
) -> Outcome<T> {
    // SAFETY: as for this function.
    let (file, asked) = unsafe { (path(file, "path")?, Asked::new(options)?) };
    // What is wrong with the request is said before a device is opened.
    asked.request.check(&file)?;
    let asked = asked.for_file(&file)?;
    let _listening = asked.control.listen();
    Ok(act(&asked.request, &file)?)
}

/// Reconstructs the surface of particles in memory.
///
/// `options` may be NULL for all defaults. `mesh`: where to put the mesh, to be freed by
/// meniscus_mesh_free; NULL where it fails.
///
/// MENISCUS_STATUS_REQUEST for arguments and options that are wrong, and for memory that does not
/// do; MENISCUS_STATUS_INPUT for particles that are not finite or too far away, have no surface, or
/// are none; MENISCUS_STATUS_OUTPUT where scratch files fail.
///
/// Pointers are NULL or point to the described data; the particles stay as they are meanwhile.
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
/// `path`: any file that the program reads; one of several steps has a number behind a colon.
/// Otherwise as meniscus_reconstruct.
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

/// Samples particles in memory once, for surfaces that may be drawn otherwise again and again.
///
/// `frame`: where to put the frame, to be freed by meniscus_frame_free; NULL where it fails.
/// Otherwise as meniscus_reconstruct. The particles are not needed any more afterwards.
///
/// Pointers are NULL or point to the described data; the particles stay as they are meanwhile.
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
/// `frame` is NULL, or a handle that is not freed yet.
unsafe fn of<'a>(frame: *const MeniscusFrame) -> Outcome<&'a MeniscusFrame> {
    // SAFETY: as for this function.
    unsafe { frame.as_ref() }.ok_or_else(|| Failure::request("frame is NULL"))
}

/// Draws a surface of a frame.
///
/// `options`: NULL for the surface that was asked for when it was sampled. Else whatever does not
/// need the particles again, from the width of smoothing to simplifying; what says how particles
/// are sampled may be as it was, and is refused otherwise (MENISCUS_STATUS_REQUEST). Memory,
/// threads, scratch folder and device stay those of the frame. Otherwise as meniscus_reconstruct.
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
        let asked = unsafe { Asked::new(options) }?;
        let _listening = asked.control.listen();
        Ok(frame.surface_by(&asked.request)?)
    };
    // SAFETY: as for this function.
    unsafe { making(mesh, "mesh", || surface().map(MeniscusMesh::new)) }
}

/// Writes a frame to a .mnf file, whole or not at all, to be surfaced later by
/// meniscus_reconstruct_file or meniscus_sample_file.
///
/// `overwrite`: not 0 to replace a file that is there. `bytes`: NULL, or where to put the file's
/// size.
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
        unsafe { tell(bytes, packed.bytes) };
        Ok(())
    })
}

/// Returns the number of doubts about the frame's particles; 0 of NULL.
///
/// `frame` is NULL, or a handle that is not freed yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_frame_warning_count(frame: *const MeniscusFrame) -> usize {
    // SAFETY: as for this function.
    unsafe { frame.as_ref() }.map_or(0, |frame| frame.warnings.len())
}

/// Returns a doubt by its number from 0, for people; valid until the frame is freed. NULL where
/// there is no such doubt.
///
/// `frame` is NULL, or a handle that is not freed yet.
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
/// `frame` is NULL, or a handle that is not freed yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_frame_free(frame: *mut MeniscusFrame) {
    // SAFETY: as for this function.
    unsafe { free(frame) };
}
