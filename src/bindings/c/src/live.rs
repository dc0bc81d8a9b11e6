//! A running simulation: frames from memory, in order, with one calibration.

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
/// the filters, and kept for all later frames. It makes one frame at a time.
pub struct MeniscusSimulation {
    live: Mutex<LiveSimulation>,
    control: Control,
}

/// Starts a simulation with its threads.
///
/// `options` may be NULL for all defaults; the callback and its argument must exist until the
/// simulation is freed. A callback cancels one frame, a handle also all later ones. `simulation`:
/// receives the handle, to be freed by meniscus_simulation_free; NULL on failure.
///
/// Pointers are NULL or point to the described data.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_simulation_new(
    options: *const MeniscusOptions,
    simulation: *mut *mut MeniscusSimulation,
) -> MeniscusStatus {
    let started = || {
        // SAFETY: as for this function.
        let asked = unsafe { RequestParts::new(options) }?.on_machine(|_| None)?;
        Ok(MeniscusSimulation {
            live: Mutex::new(LiveSimulation::new(&asked.request)?),
            control: asked.control,
        })
    };
    // SAFETY: as for this function.
    unsafe { making(simulation, "simulation", started) }
}

/// Reconstructs the surface of the next frame.
///
/// A frame without particles, or without a surface, is an empty mesh. Otherwise like
/// meniscus_reconstruct; after a failure, the next frame can still succeed. MENISCUS_STATUS_REQUEST
/// while the simulation works on another frame.
///
/// Pointers are NULL or point to the described data; the particles stay unchanged meanwhile.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_simulation_frame(
    simulation: *mut MeniscusSimulation,
    particles: *const MeniscusParticles,
    mesh: *mut *mut MeniscusMesh,
) -> MeniscusStatus {
    let made = || {
        // SAFETY: as for this function.
        let simulation = unsafe { simulation.as_ref() };
        let MeniscusSimulation { live, control } =
            simulation.ok_or_else(|| Failure::request("simulation is NULL"))?;
        // SAFETY: as for this function.
        let particles = unsafe { CallerParticles::new(particles) }?;
        // A callback that requests a frame would wait for itself.
        let Some(mut live) = live.try_lock() else {
            return Err(Failure::request("the simulation is at work on another frame"));
        };
        let control = control.for_other_work();
        live.set_control(&control.of(Reconstruction::new()));
        let _active = control.activate();
        Ok(MeniscusMesh::new(live.frame(&particles)?))
    };
    // SAFETY: as for this function.
    unsafe { making(mesh, "mesh", made) }
}

/// Returns 1 once cells, grid and calibration are fixed, else 0; 0 for NULL, and while a frame is
/// made.
///
/// `simulation` is NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_simulation_is_settled(
    simulation: *const MeniscusSimulation,
) -> i32 {
    // SAFETY: as for this function.
    let simulation = unsafe { simulation.as_ref() };
    let live = simulation.and_then(|simulation| simulation.live.try_lock());
    ask(0, || live.is_some_and(|live| live.is_settled()).into())
}

/// Frees a simulation; NULL is ignored. Its meshes stay valid.
///
/// `simulation` is NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_simulation_free(simulation: *mut MeniscusSimulation) {
    // SAFETY: as for this function.
    unsafe { free(simulation) };
}
