//! A running simulation: its frames come from memory, in order, and share one calibration.

use meniscus::{LiveSimulation, Reconstruction};
use parking_lot::Mutex;

use crate::control::{Control, free};
use crate::frame::making;
use crate::mesh::MeniscusMesh;
use crate::options::{MeniscusOptions, RequestParts};
use crate::particles::{CallerParticles, MeniscusParticles};
use crate::status::{Failure, MeniscusStatus, ask};

/// A simulation whose frames come from memory, in order. Freed by meniscus_simulation_free.
///
/// Cells, grid and calibration are measured on the first frame with fluid deeper than the reach of
/// the filters, and kept for all later frames. A simulation makes one frame at a time.
pub struct MeniscusSimulation {
    live: Mutex<LiveSimulation>,
    control: Control,
}

/// Creates a simulation, and starts its threads.
///
/// `options` may be NULL for all defaults. Their callback and its argument must exist until the
/// simulation is freed. A callback can cancel a single frame, and a cancel handle cancels all later
/// frames as well. `simulation`: receives the handle, to be freed by meniscus_simulation_free; NULL
/// on failure.
///
/// Pointers are NULL or point to the described data.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_simulation_new(
    options: *const MeniscusOptions,
    simulation: *mut *mut MeniscusSimulation,
) -> MeniscusStatus {
    let started = || {
        // SAFETY: the caller upholds this function's contract.
        let asked = unsafe { RequestParts::new(options) }?.on_machine(|_| None)?;
        Ok(MeniscusSimulation {
            live: Mutex::new(LiveSimulation::new(&asked.request)?),
            control: asked.control,
        })
    };
    // SAFETY: the caller upholds this function's contract.
    unsafe { making(simulation, "simulation", started) }
}

/// Reconstructs the surface of the next frame.
///
/// A frame without particles, or without a surface, is an empty mesh. All other results are the
/// same as those of meniscus_reconstruct. After a failure, the next frame can still succeed.
/// MENISCUS_STATUS_REQUEST while the simulation works on another frame.
///
/// Pointers are NULL or point to the described data; the particles stay unchanged meanwhile.
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
        // Do not wait for the lock: a callback that requests another frame would wait for itself.
        let Some(mut live) = live.try_lock() else {
            return Err(Failure::request("the simulation is at work on another frame"));
        };
        let control = control.for_other_work();
        live.set_control(&control.of(Reconstruction::new()));
        let _active = control.activate();
        Ok(MeniscusMesh::new(live.frame(&particles)?))
    };
    // SAFETY: the caller upholds this function's contract.
    unsafe { making(mesh, "mesh", made) }
}

/// Returns 1 if cells, grid and calibration are fixed, else 0. Also returns 0 for NULL, and while
/// the simulation works on a frame.
///
/// `simulation` is NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_simulation_is_settled(
    simulation: *const MeniscusSimulation,
) -> i32 {
    // SAFETY: the caller upholds this function's contract.
    let simulation = unsafe { simulation.as_ref() };
    let live = simulation.and_then(|simulation| simulation.live.try_lock());
    ask(0, || live.is_some_and(|live| live.is_settled()).into())
}

/// Frees a simulation; NULL is ignored. Its meshes stay valid.
///
/// `simulation` is NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_simulation_free(simulation: *mut MeniscusSimulation) {
    // SAFETY: the caller upholds this function's contract.
    unsafe { free(simulation) };
}
