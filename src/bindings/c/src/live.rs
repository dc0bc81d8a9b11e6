//! A running simulation: its frames come from memory, in order, and share one calibration.

use meniscus::{LiveSimulation, Reconstruction};
use parking_lot::Mutex;

use crate::control::{Control, free};
use crate::frame::store_handle;
use crate::mesh::MeniscusMesh;
use crate::options::{MeniscusOptions, RequestParts};
use crate::particles::{CallerParticles, MeniscusParticles};
use crate::status::{Failure, MeniscusStatus, catch_panic};

/// A simulation whose frames come from memory, in order. It must be freed by
/// meniscus_simulation_free.
///
/// Cells, grid and calibration are measured on the first frame with fluid deeper than the reach of
/// the filters, and kept for all later frames. A simulation processes one frame at a time.
pub struct MeniscusSimulation {
    live: Mutex<LiveSimulation>,
    control: Control,
}

/// Creates a simulation, and starts its threads.
///
/// If `options` is NULL, all options have their defaults. The callback in `options` and its
/// argument must exist until the simulation is freed. If `options` has no cancel handle, a callback
/// that cancels the work cancels only the current frame. If `options` has a cancel handle, the
/// callback also cancels all later frames. `simulation`: receives the handle, which must be freed
/// by meniscus_simulation_free, or NULL on failure.
///
/// Pointers must be NULL or point to the described data.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_simulation_new(
    options: *const MeniscusOptions,
    simulation: *mut *mut MeniscusSimulation,
) -> MeniscusStatus {
    let started = || {
        // SAFETY: the caller upholds this function's contract.
        let parts = unsafe { RequestParts::new(options) }?.on_machine(|_| None)?;
        Ok(MeniscusSimulation {
            live: Mutex::new(LiveSimulation::new(&parts.request)?),
            control: parts.control,
        })
    };
    // SAFETY: the caller upholds this function's contract.
    unsafe { store_handle(simulation, "simulation", started) }
}

/// Reconstructs the surface of the next frame.
///
/// A frame without particles, or without a surface, gives an empty mesh. All other results are the
/// same as those of meniscus_reconstruct. After a failure, the next frame can still succeed.
/// Returns MENISCUS_STATUS_REQUEST while the simulation is working on another frame.
///
/// Pointers must be NULL or point to the described data; the particles must not change during the
/// call.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_simulation_frame(
    simulation: *mut MeniscusSimulation,
    particles: *const MeniscusParticles,
    mesh: *mut *mut MeniscusMesh,
) -> MeniscusStatus {
    let made = || {
        // SAFETY: the caller upholds this function's contract.
        let simulation = unsafe { simulation.as_ref() };
        let MeniscusSimulation { live, control } =
            simulation.ok_or_else(|| Failure::request("simulation is NULL"))?;
        // SAFETY: the caller upholds this function's contract.
        let particles = unsafe { CallerParticles::new(particles) }?;
        // Do not wait for the lock. If a progress callback requests another frame of the same
        // simulation, its thread would wait for the current frame, which waits for the callback.
        let Some(mut live) = live.try_lock() else {
            return Err(Failure::request("the simulation is already processing another frame"));
        };
        let control = control.for_other_work();
        live.set_control(&control.attach_to(Reconstruction::new()));
        let _active = control.activate();
        Ok(MeniscusMesh::new(live.frame(&particles)?))
    };
    // SAFETY: the caller upholds this function's contract.
    unsafe { store_handle(mesh, "mesh", made) }
}

/// Returns 1 if cells, grid and calibration are fixed, and 0 otherwise. Also returns 0 for NULL,
/// and while the simulation is working on a frame.
///
/// `simulation` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_simulation_is_settled(
    simulation: *const MeniscusSimulation,
) -> i32 {
    // SAFETY: the caller upholds this function's contract.
    let simulation = unsafe { simulation.as_ref() };
    let live = simulation.and_then(|simulation| simulation.live.try_lock());
    catch_panic(0, || live.is_some_and(|live| live.is_settled()).into())
}

/// Frees a simulation; NULL is ignored. Its meshes stay valid.
///
/// `simulation` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_simulation_free(simulation: *mut MeniscusSimulation) {
    // SAFETY: the caller upholds this function's contract.
    unsafe { free(simulation) };
}
